"""One flight of a leaderboard: its summary, time and energy of each UAV, and the reason if it failed."""

import logging
from collections.abc import Mapping
from typing import Any

import numpy as np

from meanflock.launch.engine import Engine
from meanflock.results.run_folder import LOSS
from meanflock.studies.study import of_all
from meanflock.swarm import mission
from meanflock.swarm.errors import BadInput, RunFailed
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import Telemetry

STUDY = "leaderboard"  # the first word of a flight's name in the store
FAILED = "failed"  # instead of a summary: the reason
LOST = "lost_why"  # of a flight that lost UAVs: the text about the first one


def fly(flown: Scenario) -> dict[str, Any]:
    """Flies it in this process.

    Returns:
        The summary as `study.of_all` gives it, without single links, and for each UAV `travel_s` from its
        launch, None if it never arrived, and `energy_J` until its arrival or the end. Only `failed` if the flight
        failed.
    """
    try:
        engine = Engine(flown, "leaderboard")
        result = of_all(flown, engine.complete())
    except (BadInput, RunFailed) as error:
        return {FAILED: str(error)}
    flight = engine.world.flight
    arrived = flight.arrival_tick >= 0
    times = ((flight.arrival_tick - mission.launches(flown)) * flown.dt).tolist()
    result["radio"] = {name: value for name, value in result["radio"].items() if name != "links"}
    result["travel_s"] = [
        time if has_arrived else None for time, has_arrived in zip(times, arrived.tolist(), strict=True)
    ]
    result["energy_J"] = np.where(arrived, flight.arrival_energy, flight.energy).tolist()
    if result["lost"] and not flown.faults:
        result[LOST] = _why(flown)
    return result


def of_group(result: Mapping[str, Any], name: str, rows: slice) -> dict[str, Any]:
    """The part of a flight that is one group's, as `fly` returns it; `rows`: of its UAVs."""
    if FAILED in result:
        return dict(result)
    each = {key: result[key][rows] for key in ("travel_s", "energy_J")}
    return {**result["groups"][name], **each, LOST: result.get(LOST)}


class _FirstWord:
    """Sink that stores the text of the first event about a lost UAV."""

    def __init__(self) -> None:
        self.text = ""

    def write(self, block: Telemetry) -> None:
        """Search the events of a block."""
        texts = (event.text for event in block.events if isinstance(event, LOSS))
        self.text = self.text or next(texts, "")


def _why(flown: Scenario) -> str:
    """Repeat the flight, which has the same bits, until an event names the reason of a loss."""
    first = _FirstWord()
    log = logging.getLogger("meanflock.agent")
    before, log.disabled = log.disabled, True  # the first flight had such an event
    try:
        engine = Engine(flown, "leaderboard", sinks=[first])
        if not any(first.text for _ in engine.fly()):
            engine.finish()
    finally:
        log.disabled = before
    return first.text or "UAVs were lost"
