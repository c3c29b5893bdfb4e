"""How the report words its claims: the rule they are judged by, and the numbers measured for them."""

from collections.abc import Mapping, Sequence
from typing import Any

from meanflock.studies.paper.outcome import number

RULE = (
    "A check holds if its whole 95 % interval over seeds lies on the claimed side of the threshold, fails if the "
    "whole interval lies on the other side, and is undecided if the threshold lies in the interval. A claim is "
    "reproduced if every check of it holds, not reproduced if one fails, and undecided if none fails and one is "
    "undecided or has no data. It is not testable if no data could decide, or if all are missing or come from a "
    "single seed (unless the run has no chance in it). A claim that holds is not called reproduced where its checks "
    "can hardly fail: it is “reproduced, by construction” if it follows from how it is asked, and “not refuted” if "
    "only a learner or a state that diverges could fail it. "
    "Methods are paired by seed: the same seed is the same wind. Means, differences and slopes have Student's "
    "interval, ratios of means Fieller's, shares of runs Clopper and Pearson's, counts Garwood's. A best case "
    "(“up to”) is the comparison with the largest lower bound over all grid points and baselines, its interval "
    "widened to hold for all of them at once; it fails only if all of them do. “Most” of a grid is more than half of "
    "its points. Thresholds and their reading are data: claims.toml."
)


def values(record: Mapping[str, Any]) -> list[str]:
    """The numbers of a claim, one line each: `mfgfl-hf: 21.3 [20.1, 22.5]`."""
    value, interval = record["value"], record["ci95"]
    if value is None:
        return []
    if not isinstance(value, Mapping):
        return [interval_text(value, interval)]
    return [f"{name}: {interval_text(each, interval[name])}" for name, each in value.items()]


def interval_text(value: float | None, interval: Sequence[float | None]) -> str:
    """`21.3 [20.1, 22.5]`, with ? for what is unbounded or unknown."""
    low, high = interval
    return number(value) + (f" [{number(low)}, {number(high)}]" if low is not None or high is not None else "")
