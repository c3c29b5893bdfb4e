"""Reasons of failures in a flight of a study: of lost UAVs, of rounds without average, of trainings without model, and
of random numbers that no other flight draws."""

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from meanflock.results.run_folder import LOSS, NO_AVERAGE
from meanflock.swarm.events import AgentFailed, Diverged, FitFailed, GlobalDraw, Lost
from meanflock.worldsim.failures import NUMBER
from meanflock.worldsim.tick import Row

FAILURES = "failures"  # reasons, which a study stores beside the fields of a summary
_MOST = 10  # reasons of a flight, and of a study
_VARYING = re.compile(rf" with UAVs? [^:]*|{NUMBER.pattern}")  # in a text about one cause


class FailureReasons:
    """Sink that collects the distinct reasons of the failures of a flight, in order of time.

    Reasons that differ in UAVs and numbers only are one, with the text of the first. The loss of a UAV has no reason of
    its own in the tick in which its agent reports one. Random numbers come last, because nothing fails of them.
    """

    def __init__(self, has_faults: bool) -> None:
        """`has_faults`: whether a fault script of the flight loses UAVs, which is no failure."""
        self._kinds = (*NO_AVERAGE, FitFailed) + (() if has_faults else LOSS)
        self._texts: dict[str, str] = {}
        self._draws: list[str] = []

    def write(self, row: Row) -> None:
        """Look for failures in the events of a row."""
        self._draws += [event.text for event in row.events if isinstance(event, GlobalDraw)]
        failed = [event for event in row.events if isinstance(event, self._kinds)]
        is_reported = any(isinstance(event, AgentFailed) for event in failed)
        for event in failed:
            if isinstance(event, Diverged | Lost):
                if is_reported:
                    continue
                text = event.reason
            else:
                text = event.failure
            if len(self._texts) < _MOST:
                self._texts.setdefault(_VARYING.sub("", text), text)

    @property
    def fields(self) -> dict[str, Any]:
        """The reasons, as a study stores them."""
        return {FAILURES: [*self._texts.values(), *self._draws]}


def counted_reasons(flights: Iterable[Mapping[str, Any]]) -> Sequence[tuple[str, int]]:
    """The distinct reasons of some flights and the number of flights of each, the most frequent ones first."""
    texts: dict[str, list[str]] = {}
    for flight in flights:
        for text in flight[FAILURES]:
            texts.setdefault(_VARYING.sub("", text), []).append(text)
    return sorted(((found[0], len(found)) for found in texts.values()), key=lambda one: -one[1])[:_MOST]
