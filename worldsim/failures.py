"""Failures that nodes report in a tick, and their events."""

import re
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from meanflock.federation.groups import Group, group_number
from meanflock.swarm.events import AgentFailed, AverageFailed, FitFailed, LeaderFailed
from meanflock.swarm.events.base import listed
from meanflock.swarm.events.nodes import FailedAverage, FailedController, FailedTraining, FoundDraw, Problem
from meanflock.swarm.state import Mask

_Failed: TypeAlias = str | FailedController | FailedTraining | FailedAverage
Failure: TypeAlias = LeaderFailed | AgentFailed | AverageFailed | FitFailed

NUMBER = re.compile(r"\d[\d.e+-]*")  # in a text: those that differ in numbers only have one cause
_ORDER = (LeaderFailed, AgentFailed, AverageFailed, FitFailed)  # of the events of a tick


class Reports:
    """Reports of all nodes in a tick, in the order in which they came.

    Attributes:
        leader_failed: whether a leader reported a failure.
        unaveraged: UAVs at which the aggregation rule failed.
        found_draw: whether a node reported a draw from a global random generator.
    """

    def __init__(self) -> None:
        self.leader_failed = False
        self.unaveraged: set[int] = set()
        self.found_draw = False
        self._reports: list[tuple[str, NDArray[np.intp], _Failed]] = []

    def add(self, node: str, uavs: NDArray[np.intp], problem: Problem, *, has_event: bool = True) -> None:
        """Add what a node with some UAVs (M,), ascending, reports; a leader has none. `has_event`: whether an event
        says so."""
        if isinstance(problem, FoundDraw):
            self.found_draw = True
            return
        self.leader_failed |= not len(uavs)
        if isinstance(problem, FailedAverage):
            self.unaveraged.update(problem.uavs)
        if has_event:
            self._reports.append((node, uavs, problem))

    def events(self, tick: int, awake: Mask, groups: Sequence[Group]) -> list[Failure]:
        """The events of the reports, sorted by kind and first UAV: their order depends on no node and no network.

        A node computes all of its UAVs if one of them is `awake` (N,), and is not asked if none is. Therefore events
        leave out UAVs that are not. Failures of a controller that differ in numbers only are one event, with the text
        of the first UAV.
        """
        if not self._reports:
            return []
        of_controllers: dict[tuple[str, str, str], dict[int, str]] = {}  # failures by UAV; by node, method and text
        found: list[tuple[int, int, Failure]] = []
        for node, own, problem in self._reports:
            event: Failure
            if isinstance(problem, str):
                first = int(own[0]) if len(own) else 0
                event = (AgentFailed if len(own) else LeaderFailed)(tick, node, problem)
            elif uavs := tuple(uav for uav in problem.uavs if awake[uav]):
                first = min(uavs)
                match problem:
                    case FailedTraining():
                        event = FitFailed(tick, node, problem.failure, first)
                    case FailedAverage():
                        event = AverageFailed(tick, node, problem.failure, uavs)
                    case _:
                        method = groups[group_number(groups, own)].scenario.method
                        alike = node, method, NUMBER.sub("", problem.failure)
                        of_controllers.setdefault(alike, {}).update(dict.fromkeys(uavs, problem.failure))
                        continue
            else:
                continue
            found.append((_ORDER.index(type(event)), first, event))
        for (node, method, _), failures in of_controllers.items():
            uavs = tuple(sorted(failures))
            failure = f"controller {method!r} failed with {listed(uavs)}: {failures[uavs[0]]}"
            found.append((_ORDER.index(AgentFailed), uavs[0], AgentFailed(tick, node, failure)))
        return [event for *_, event in sorted(found, key=lambda one: one[:2])]
