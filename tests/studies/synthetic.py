"""Tables with known answers, in the columns of `studies/paper/tables.py`."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa

from meanflock.studies.paper.tables import COORDINATES, Results

COLUMNS = {"uavs": 25, "period": None, "sigma": 0.1, "setting": "", "trained": False}


def row(experiment: str, method: str, seed: int, **values: Any) -> dict[str, Any]:
    """One run; coordinates default to S0's."""
    return {"experiment": experiment, "method": method, "seed": seed, **COLUMNS, **values}


def results(rows: Sequence[Mapping[str, Any]], **tables: pa.Table) -> Results:
    """Results with these runs and, where given, other tables."""
    empty = {name: COORDINATES.empty_table() for name in ("series", "trajectories", "weights")}
    return Results(runs=pa.Table.from_pylist([dict(each) for each in rows]), **{**empty, **tables})


def noisy(metric: str, levels: Mapping[str, float], seeds: int = 12, noise: float = 0.05) -> list[dict[str, Any]]:
    """S0 runs whose metric is the method's level plus noise its seed shares among methods, and a little of its own."""
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
