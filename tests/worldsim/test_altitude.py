"""Floor and ceiling: the world counts who goes beyond them; filters, orca and bvc keep UAVs between them."""

from typing import Any

import numpy as np
import pytest

import meanflock as mf
from meanflock.swarm.scenario import Scenario
from meanflock.worldsim.flight import Flight

CALM = {"wind.sigma": 0.0, "wind.drag": 0.0, "space.dimensions": 3}


def flight_between(floor: float | None, ceiling: float | None, *places: tuple[float, ...], **keys: Any) -> Flight:
    limits = {"space.floor": floor, "space.ceiling": ceiling}
    return Flight(Scenario(uavs=len(places), start={"positions": places}, **CALM, **limits, **keys))


def push(flight: Flight, ticks: int, *upward: float) -> list[str]:
    """Fly so many ticks with these accelerations along z; the texts of the events of altitude."""
    for _ in range(ticks):
        flight.advance(np.array([[0.0, 0.0, one] for one in upward]))
    return [event.text for event in flight.events if event.kind == "altitude"]


def test_each_uav_and_limit_counts_once_and_the_uav_flies_on() -> None:
    flight = flight_between(38.0, 42.0, (50.0, 0.0), (50.0, 9.0))
    assert push(flight, 30, 1.0, 0.0) == ["UAV 0 went above the ceiling of 42 m"]
    assert flight.states[0, 2] > 44.0
    assert push(flight, 80, -2.0, 0.0)[1:] == ["UAV 0 went below the floor of 38 m"]
    assert len(push(flight, 100, 2.0, 0.0)) == 2
    assert flight.altitude.beyond.tolist() == [[True, True], [False, False]]


def test_the_floor_counts_only_once_a_uav_has_risen_above_it() -> None:
    flight = flight_between(40.0, None, (50.0, 0.0), (50.0, 9.0))
    assert push(flight, 10, -1.0, 0.0) == []
    push(flight, 30, 2.0, 0.0)
    assert flight.altitude.risen.tolist() == [True, False]
    assert push(flight, 60, -3.0, 0.0) == ["UAV 0 went below the floor of 40 m"]


def test_a_uav_that_has_arrived_may_leave_the_altitudes() -> None:
    flight = flight_between(38.0, 42.0, (0.0, 1.0, 41.0), stop="duration")
    assert push(flight, 30, 2.0) == []
    assert flight.arrival_tick[0] == 1


def test_limits_of_altitude_are_in_the_summary_and_the_checkpoint() -> None:
    keys: dict[str, Any] = {**CALM, "method": "cruise", "uavs": 2, "duration": 2.0}
    assert mf.fly(Scenario(**keys)).summary["altitude_violations"] is None
    gust = {"kind": "gust", "tick": 2, "duration_s": 1.0, "acceleration": (0.0, 0.0, 9.0)}
    run = mf.fly(Scenario(**keys, space={"dimensions": 3, "ceiling": 41.0}, faults=[gust]))
    assert run.summary["altitude_violations"] == 2
    assert sum(event["kind"] == "altitude" for event in run.events) == 2


SUBJECTS = {
    "orca": {"method": "orca"},
    "bvc": {"method": "bvc"},
    **{kind: {"method": "cruise", "filter.kind": kind} for kind in ("ecbf", "braking")},
}


@pytest.mark.parametrize("upward", [1.0, -1.0], ids=["ceiling", "floor"])
@pytest.mark.parametrize("subject", SUBJECTS.values(), ids=SUBJECTS)
def test_an_unknown_wind_does_not_carry_a_uav_beyond_a_limit(subject: dict[str, Any], upward: float) -> None:
    limit = {"floor" if upward < 0.0 else "ceiling": 40.0 + 0.7 * upward}
    wind = {"truth.wind": (1.0, -1.0, 2.0 * upward), "wind.drag": 0.2}
    keys: dict[str, Any] = {"uavs": 2, "duration": 20.0, "start.centre": (40.0, 0.0), **wind, **subject}
    free = mf.fly(Scenario(**keys, space={"dimensions": 3})).states[..., 2]
    kept = mf.fly(Scenario(**keys, space={"dimensions": 3, **limit}))
    assert (upward * (free - 40.0)).max() > 0.7
    assert (upward * (kept.states[..., 2] - 40.0)).max() < 0.7
    assert kept.summary["altitude_violations"] == 0
    assert kept.summary["arrived"] == 2
