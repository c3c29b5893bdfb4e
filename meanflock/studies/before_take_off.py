"""Warnings before take-off, and at which points of a study they hold."""

import logging
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from meanflock.channel import outlook
from meanflock.results.points import labels
from meanflock.swarm import logs
from meanflock.swarm.scenario import Scenario
from meanflock.worldsim.faults import never
from meanflock.worldsim.vehicles.base import ignored

_MOST = 3  # points that a warning names


def warn(names: Sequence[str], scenarios: Mapping[tuple[Any, ...], Scenario]) -> None:
    """Print each note of some scenarios once, and at which points it holds if not at all.

    Args:
        names: of the varied values. scenarios: by the values of their point.
    """
    found: dict[tuple[str, int], list[str]] = {}
    named = labels(names, scenarios)
    for point, flown in scenarios.items():
        for note in dict.fromkeys(_notes(flown)):
            found.setdefault(note, []).append(named[point])
    for (text, level), having in found.items():
        if len(having) < len(scenarios):
            listed = "; ".join([*having[:_MOST], *["…"] * (len(having) > _MOST)])
            text = f"at {len(having)} of {len(scenarios)} points ({listed}): {text}"
        logs.note(text, level)


def _notes(flown: Scenario) -> Iterator[tuple[str, int]]:
    """Commands without effect, faults that begin after the end, and models that are cut or will mostly be lost."""
    for event in (*ignored(flown), *never(flown)):
        yield event.text, logging.WARNING
    yield from outlook.notes(flown)
