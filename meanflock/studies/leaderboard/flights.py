"""One flight of a leaderboard: its summary, time and energy of each UAV, and the reason if it failed."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from meanflock.launch.engine import Engine
from meanflock.studies.failure_reasons import FAILURES, FailureReasons
from meanflock.studies.study import of_all
from meanflock.swarm import mission
from meanflock.swarm.errors import BadInput, RunFailed
from meanflock.swarm.scenario import Scenario

STUDY = "leaderboard"  # the first word of a flight's name in the store
FAILED = "failed"  # instead of a summary: the reason


def fly(flown: Scenario) -> dict[str, Any]:
    """Flies it in this process.

    Returns:
        The summary as `study.of_all` gives it, without single links, and for each UAV `travel_s` from its
        launch, None if it never arrived, and `energy_J` until its arrival or the end; and the reasons of its failures.
        Only `failed` if the flight failed.
    """
    failures = FailureReasons(bool(flown.faults))
    try:
        engine = Engine(flown, "leaderboard")
        engine.add_sink(failures)
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
    return {**result, **failures.fields}


def of_group(result: Mapping[str, Any], name: str, rows: slice) -> dict[str, Any]:
    """The part of a flight that is one group's, as `fly` returns it; `rows`: of its UAVs."""
    if FAILED in result:
        return dict(result)
    each = {key: result[key][rows] for key in ("travel_s", "energy_J")}
    return {**result["groups"][name], **each, FAILURES: result[FAILURES]}
