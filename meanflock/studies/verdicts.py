"""Verdicts of a study: which points are significantly best at what, paired by seed.

The best mean of a column is compared with every other one, flight by flight, by Student's paired t test. All
comparisons of a study are one family: by Holm's method the chance that any of them is wrong is at most 5 %.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from meanflock.results.scenario_keys import group_and_key
from meanflock.studies.leaderboard.marks import holm, paired
from meanflock.studies.objectives import COMPARED_OBJECTIVES, ROUNDING, Objective

Point = tuple[Any, ...]
Points = Mapping[Point, Sequence[Mapping[str, Any]]]
Verdict = Literal["best", "worse", "undecided", "equal"]
_RIVALS = ("method", "training.learner")  # what is compared where other keys are equal; also those of one group


def verdicts(
    names: Sequence[str], points: Points, objectives: Sequence[Objective] = COMPARED_OBJECTIVES
) -> dict[tuple[Point, str], Verdict]:
    """The verdict on each point and objective, by the point and the name of the objective.

    Rivals are points that differ in method or learner only; if the study has one method and learner, all points are.
    `best`: significantly better than all rivals. `worse`: significantly worse than the rival with the best mean.
    `equal`: all rivals have the same numbers. `undecided`: else. Points with fewer than two flights, or a flight
    without the number, have no verdict.
    """
    found: dict[tuple[Point, str], Verdict] = {}
    tests: list[tuple[float, str, Point, Point]] = []  # p value, objective, best and other point
    for objective in objectives:
        for group in _groups(names, points):
            values = {point: np.array(objective.values(points[point])) for point in group}
            values = {point: one for point, one in values.items() if len(one) > 1 and np.isfinite(one).all()}
            if len(values) > 1:
                found |= dict.fromkeys(((point, objective.name) for point in values), _first_verdict(values))
                best = _best(objective, values)
                for point, one in values.items():
                    if point != best:
                        p_value = 1.0 if _is_equal(values[best], one) else paired(values[best], one)
                        tests.append((p_value, objective.name, best, point))
    for (_, name, _, point), is_worse in zip(tests, holm([test[0] for test in tests]), strict=True):
        if is_worse:
            found[point, name] = "worse"
    for name, best in {(name, best) for _, name, best, _ in tests}:
        if all(found[point, name] == "worse" for _, one, leader, point in tests if (one, leader) == (name, best)):
            found[best, name] = "best"
    return found


def _groups(names: Sequence[str], points: Points) -> list[list[Point]]:
    """The points by what is equal among rivals."""
    differing = rivalry(names, points)
    if not differing:
        return [list(points)]
    groups: dict[Point, list[Point]] = {}
    for point in points:
        same = tuple(each for name, each in zip(names, point, strict=True) if name not in differing)
        groups.setdefault(same, []).append(point)
    return list(groups.values())


def rivalry(names: Sequence[str], points: Iterable[Point]) -> list[str]:
    """The names of the values in which rivals differ, all others being equal; empty if all points are rivals."""
    values = zip(names, zip(*points, strict=True), strict=True)
    return [name for name, found in values if group_and_key(name)[1] in _RIVALS and len({*found}) > 1]


def _first_verdict(values: Mapping[Point, NDArray[np.float64]]) -> Verdict:
    first, *others = values.values()
    return "equal" if all(_is_equal(first, other) for other in others) else "undecided"


def _is_equal(first: NDArray[np.float64], second: NDArray[np.float64]) -> bool:
    return np.allclose(first, second, rtol=ROUNDING, atol=0.0)


def _best(objective: Objective, values: Mapping[Point, NDArray[np.float64]]) -> Point:
    sign = 1.0 if objective.better == "less" else -1.0
    return min(values, key=lambda point: sign * float(values[point].mean()))
