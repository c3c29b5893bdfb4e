"""Flights in one process, with all that was reported of them."""

import re
from collections.abc import Iterable
from typing import Any

import msgspec
import numpy as np

from meanflock.launch.engine import Engine
from meanflock.launch.station import StoredTelemetry
from meanflock.swarm.events import (
    KINDS,
    AgentFailed,
    AverageFailed,
    FitFailed,
    FlightEvent,
    FlightResumed,
    LeaderFailed,
    NodesJoined,
)
from meanflock.swarm.scenario import Scenario
from meanflock.worldsim.checkpoint import Resumption, decoded


class Record(StoredTelemetry):
    """The telemetry of a flight, and what its events say."""

    @property
    def events(self) -> list[FlightEvent]:
        return self.events_from(0)

    def events_from(self, first: int) -> list[FlightEvent]:
        """The events from a block on."""
        events = [event for block in self.blocks[first:] for event in block.events]
        assert {event.kind for event in events} <= set(KINDS)  # docs/data.md describes these
        return events

    @property
    def texts(self) -> list[str]:
        return [event.text for event in self.events]

    def kinds(self, *kinds: str) -> list[tuple[int, str]]:
        return [(event.tick, event.kind) for event in self.events if event.kind in kinds]

    @property
    def checkpoints(self) -> list[Resumption]:
        """All that the flight could continue from, in order of time."""
        carriers = [number for number, block in enumerate(self.blocks) if block.checkpoint]
        states = [np.concatenate([block.states for block in self.blocks[: number + 1]]) for number in carriers]
        raws = [self.blocks[number].checkpoint for number in carriers]
        return [Resumption(decoded(raw), history) for raw, history in zip(raws, states, strict=True)]


def fly(scenario: Scenario, rows: int | None = None, **more: Any) -> tuple[dict[str, Any], Record]:
    """To the end: the summary and the record. `rows`: UAVs of an agent; `more` is of the engine."""
    record = Record()
    engine = Engine(scenario, "flight", uavs_per_node=rows, sinks=[record], **more)
    for _ in engine.fly():
        pass
    return engine.finish(), record


_OF_CONTROLLER = re.compile(r"(controller '.+' failed) with UAVs? ([\d, ]+): (.*)")


def comparable(events: Iterable[FlightEvent]) -> list[Any]:
    """Events without what depends on how a flight divides its UAVs among nodes: the number and the names of nodes, and
    whether one event or several say that something failed at UAVs. Then the first reason counts, and all UAVs."""
    found: list[Any] = []
    for event in events:
        match event:
            case NodesJoined() | FlightResumed():
                continue
            case AverageFailed():
                failed = [event.tick, "rule", event.failure, [*event.uavs]]
            case AgentFailed() if told := _OF_CONTROLLER.fullmatch(event.failure):
                failed = [event.tick, told[1], told[3], [*map(int, told[2].split(", "))]]
            case AgentFailed() | LeaderFailed() | FitFailed():
                found.append(msgspec.structs.replace(event, node=""))
                continue
            case _:
                found.append(event)
                continue
        if found and isinstance(found[-1], list) and found[-1][:2] == failed[:2]:
            found[-1][3] = sorted([*found[-1][3], *failed[3]])
        else:
            found.append(failed)
    return found
