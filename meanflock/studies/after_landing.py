"""Warnings after the flights of a study: of lost UAVs, of rounds that federated nothing, and of what failed."""

import logging
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from meanflock.studies.failure_reasons import counted_reasons
from meanflock.swarm import logs
from meanflock.swarm.scenario import Scenario


def warn(scenarios: Iterable[Scenario], summaries: Sequence[Mapping[str, Any]]) -> None:
    """Print how many flights lost UAVs without a fault script, how many federated nothing, and why.

    Args:
        scenarios: one of each point. summaries: of all flights.
    """
    lost = [] if any(flown.faults for flown in scenarios) else [one["lost"] for one in summaries if one["lost"]]
    void = [summary for summary in summaries if summary["rounds_void"] and not summary["rounds"]]
    every, reasons = len(summaries), counted_reasons(summaries)
    if lost:
        logs.note(f"flights that lost UAVs: {len(lost)} of {every}, {sum(lost)} UAVs", logging.WARNING)
    if void:
        why = "" if reasons else "; `meanflock run` with the values of one says why"
        logs.note(f"flights whose rounds were all void: {len(void)} of {every}{why}", logging.WARNING)
    for reason, flights in reasons:
        logs.note(f"in {flights} of {every} flights: {reason}", logging.WARNING)
