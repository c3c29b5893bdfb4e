"""The learned φ_G at take-off, where only the sample points of the fit differ; they come from the scenario's seed."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from meanflock.agent.controllers.mean_field import learner
from meanflock.kernels.mean_field import features, interaction
from meanflock.kernels.mean_field.layout import DENSITY_FEATURES
from meanflock.studies.study import Summaries
from meanflock.swarm import mission
from meanflock.swarm.scenario import Scenario
from research.mean_field_limit.cases import FIRST_SEED, Row, root_mean_square, shortened
from research.mean_field_limit.flights import BEGINNING, CENTRES, TIMES_S, SwarmCase, flight

FIT = "fit"  # in place of the flight of a row
UAVS = 1_000
POINTS = (1_000, 4_000, 16_000)  # near the starts, and as many in the box
SEEDS = range(FIRST_SEED, FIRST_SEED + 21)  # the others are compared with the first


def fits() -> dict[int, list[Scenario]]:
    """Scenarios by the number of points: a seed each, and the starts of the first for all."""
    flown = flight(SwarmCase(UAVS, BEGINNING), FIRST_SEED)
    return {
        points: [
            flown.replace(**{"seed": seed, "density.near_samples": points, "density.box_samples": points})
            for seed in SEEDS
        ]
        for points in POINTS
    }


def measure(scenario: Scenario) -> dict[str, Any]:
    """Fit the density to the starts of a scenario; φ_G at the nodes of the first time that is compared."""
    tables = learner.tables(scenario)
    weights = learner.fit(scenario.density, scenario.seed, tables, mission.starts(scenario))[:DENSITY_FEATURES]
    nodes = CENTRES[TIMES_S[0]] + learner.offsets(scenario.density, scenario.dimensions)
    terms = features.density(tables, nodes)
    return {"phi_G_learned": interaction.quadrature(tables, np.tile(weights, (len(nodes), 1)), terms).tobytes()}


def rows_of(measured: Mapping[int, Summaries]) -> list[Row]:
    """Rows of the results: by points and seed, the root mean square of the difference from the first seed."""
    rows: list[Row] = []
    for points, found in measured.items():
        first, *others = (np.frombuffer(each["phi_G_learned"]) for each in found)
        for seed, other in zip(SEEDS[1:], others, strict=True):
            apart = shortened(float(root_mean_square(other - first)))
            rows.append({"uavs": UAVS, "flight": FIT, "seed": seed, "points": points, "phi_G_learned": apart})
    return rows
