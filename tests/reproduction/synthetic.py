"""Tables with known answers, in the columns of `reproduction/tables.py`."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa

from research.reproduction.tables import COORDINATES, Results

COLUMNS = {"uavs": 25, "period": None, "sigma": 0.1, "setting": "", "trained": False}
# Settings of a small map: setting, energy of mfgfl-hf over that of the other methods, UAVs that arrive.
MAP = (
    ("", 0.9, 25),
    ("learner.position_scale=200, learner.velocity_scale=80, learner.kappa=0.04", 0.5, 24),
    ("learner.position_scale=900, learner.velocity_scale=75, learner.kappa=0.03, federation.period=200", 0.5, 24),
    ("learner.position_scale=300, learner.velocity_scale=60, learner.kappa=0, learner.multinomial=true", 0.95, 25),
    ("learner.position_scale=300, learner.velocity_scale=120, learner.kappa=0.1", 0.4, 3),
)


def row(experiment: str, method: str, seed: int, **values: Any) -> dict[str, Any]:
    """One run; coordinates default to S0's."""
    return {"experiment": experiment, "method": method, "seed": seed, **COLUMNS, **values}


def results(rows: Sequence[Mapping[str, Any]], **tables: pa.Table) -> Results:
    """Results with these runs and, where given, other tables."""
    empty = {name: COORDINATES.empty_table() for name in ("series", "trajectories", "weights")}
    return Results(runs=pa.Table.from_pylist([dict(each) for each in rows]), **{**empty, **tables})


def noisy(metric: str, levels: Mapping[str, float], seeds: int = 12, noise: float = 0.05) -> list[dict[str, Any]]:
    """S0 runs: the method's level, noise that a seed shares among methods, and a little noise of each run."""
    draw = np.random.default_rng(7)
    shared = draw.normal(0.0, 10 * noise, seeds)
    own = {method: draw.normal(0.0, noise, seeds) for method in levels}
    return [
        row("s0", method, seed, **{metric: level + shared[seed] + own[method][seed]})
        for method, level in levels.items()
        for seed in range(seeds)
    ]


def gridded(
    metric: str, experiment: str, column: str, lines: Mapping[str, Mapping[float, float]], seeds: int = 12
) -> list[dict[str, Any]]:
    """Runs along a grid: method → point → level, with a little noise of every run."""
    draw = np.random.default_rng(11)
    return [
        row(experiment, method, seed, **{column: point, metric: level + float(draw.normal(0.0, 0.02))})
        for method, line in lines.items()
        for point, level in line.items()
        for seed in range(seeds)
    ]


def map_rows() -> list[dict[str, Any]]:
    """Two flights of every setting of the map, with each method that shares models."""
    return [
        row(
            "map",
            method,
            seed,
            setting=setting,
            arrived=arrived,
            energy_mean_J=energy if method == "mfgfl-hf" else 1.0,
            t_avg_censored_s=110.0 if method == "mfgfl-hf" else 100.0,
            collisions_mission=0.0 if (method, seed) == ("mfgfl-hf", 6001) else 3.0,
        )
        for setting, energy, arrived in MAP
        for method in ("mfgfl-h", "mfgfl-f", "mfgfl-hf")
        for seed in (6001, 6002)
    ]
