"""The Pareto front of a study: the points to which no other is preferable in two objectives at once."""

from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from meanflock.results import statistics
from meanflock.results.statistics import Estimate
from meanflock.studies.objectives import ROUNDING, Objective

Point = tuple[Any, ...]
Place = Literal["front", "dominated", "undecided", ""]
Pair = tuple[list[float], list[float]]  # the numbers of the flights of a point, in both objectives
_Relation = Literal["better", "worse", "equal", "undecided"]


class PlacedPoint(NamedTuple):
    """Means of a point with their intervals, and its place; the place is empty if a flight lacks a number."""

    x: Estimate
    y: Estimate
    place: Place


class Tradeoff(NamedTuple):
    """Two objectives, and the place of each point of a study.

    A point dominates another if it is better in one objective and better or equal in the other. `dominated`: a point
    dominates this one beyond doubt. `front`: none does beyond doubt, and none may. `undecided`: else.
    """

    x: Objective
    y: Objective
    placed: dict[Point, PlacedPoint]


def tradeoff(points: Mapping[Point, Sequence[Mapping[str, Any]]], x: Objective, y: Objective) -> Tradeoff:
    """The places of all points. Two points are compared by the 95 % interval of their difference, paired by seed."""
    values = {point: (x.values(flights), y.values(flights)) for point, flights in points.items()}
    complete = {point: pair for point, pair in values.items() if np.isfinite(pair).all()}
    placed: dict[Point, PlacedPoint] = {}
    for point, pair in values.items():
        others = [other for at, other in complete.items() if at != point]
        place = _place((x, y), pair, others) if point in complete else ""
        placed[point] = PlacedPoint(statistics.mean(pair[0]), statistics.mean(pair[1]), place)
    return Tradeoff(x, y, placed)


def _place(objectives: tuple[Objective, Objective], own: Pair, others: Sequence[Pair]) -> Place:
    found = [
        [_relation(objective, theirs, mine) for objective, theirs, mine in zip(objectives, other, own, strict=True)]
        for other in others
    ]
    rivals = [relations for relations in found if "worse" not in relations and set(relations) != {"equal"}]
    if any("undecided" not in relations for relations in rivals):
        return "dominated"
    return "undecided" if rivals else "front"


def _relation(objective: Objective, first: Sequence[float], second: Sequence[float]) -> _Relation:
    """What the first column is, compared with the second one of the same seeds."""
    if np.allclose(first, second, rtol=ROUNDING, atol=0.0):
        return "equal"
    difference = statistics.difference(first, second)
    if difference.low <= 0.0 <= difference.high:
        return "undecided"
    return "better" if (difference.value < 0.0) == (objective.better == "less") else "worse"
