"""Flights in one process, with all that was reported of them."""

from typing import Any

import numpy as np

from meanflock.launch.engine import Engine
from meanflock.launch.station import StoredTelemetry
from meanflock.swarm.events import KINDS, FlightEvent
from meanflock.swarm.scenario import Scenario
from meanflock.worldsim.checkpoint import Resumption


class Record(StoredTelemetry):
    """The telemetry of a flight, and what its events say."""

    @property
    def events(self) -> list[FlightEvent]:
        events = [event for block in self.blocks for event in block.events]
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
        return [Resumption.decode(raw, history) for raw, history in zip(raws, states, strict=True)]


def fly(scenario: Scenario, rows: int | None = None, **more: Any) -> tuple[dict[str, Any], Record]:
    """To the end: the summary and the record. `rows`: UAVs of an agent; `more` is of the engine."""
    record = Record()
    engine = Engine(scenario, "flight", uavs_per_node=rows, sinks=[record], **more)
    for _ in engine.fly():
        pass
    return engine.finish(), record
