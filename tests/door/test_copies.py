"""A flight that is copied between two steps, or pickled, flies on as the one it was copied from."""

import copy
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import meanflock as mf
from meanflock import env
from meanflock.federation.plan import plan_of

COPIES: list[Callable[[Any], Any]] = [copy.deepcopy, lambda thing: pickle.loads(pickle.dumps(thing))]
ways = pytest.mark.parametrize("copied", COPIES, ids=["deepcopy", "pickle"])
KEYS: list[dict[str, Any]] = [
    {},
    {"filter.kind": "ecbf", "radio.target_snr_db": 77.0},
    {"parameters": 3, "federation.period": 20, "federation.topology": "neighbours", "faults": [
        {"kind": "pause", "time_s": 4.5, "duration_s": 2.0, "uavs": [1]}, {"kind": "kill", "time_s": 5.0, "uavs": [2]}
    ]},
]  # fmt: skip


def commanded(flight: mf.Stepped, ticks: int) -> None:
    for _ in range(ticks):
        states = flight.states
        broadcasts = [mf.Broadcast(states.copy())] if plan_of(flight.scenario).declared.broadcast_numbers else []
        models = flight.models + states[:, :3] if plan_of(flight.scenario).declared.parameters else None
        flight.step(-0.02 * states[:, :2] - 0.3 * states[:, 2:], broadcasts, models)


@ways
@pytest.mark.parametrize("keys", KEYS, ids=["plain", "filtered", "federated with faults"])
def test_a_copy_made_in_flight_ends_with_the_same_bits(copied: Callable[[Any], Any], keys: dict[str, Any]) -> None:
    flight = mf.Stepped("paper", uavs=4, seed=3, duration=20.0, stop="duration", **keys)
    commanded(flight, 50)
    other = copied(flight)
    commanded(flight, 150)
    commanded(other, 150)
    first, second = flight.finish(), other.finish()
    for name in ("trajectory_sha256", "models_sha256", "payload_bits", "collisions_all", "phi_A", "energy_mean_J"):
        assert first.summary[name] == second.summary[name], name
    np.testing.assert_array_equal(first.states, second.states)


def test_a_copy_leaves_the_flight_alone_and_may_be_commanded_otherwise() -> None:
    flight, undisturbed = (mf.Stepped("paper", uavs=3, seed=1, duration=6.0, stop="duration") for _ in range(2))
    commanded(flight, 20)
    other = copy.deepcopy(flight)
    for _ in range(40):
        other.step(np.ones((3, 2)))
    commanded(flight, 40)
    commanded(undisturbed, 60)
    assert flight.finish().summary["trajectory_sha256"] == undisturbed.finish().summary["trajectory_sha256"]
    assert other.finish().summary["trajectory_sha256"] != undisturbed.finish().summary["trajectory_sha256"]


@ways
def test_copies_of_environments_observe_and_reward_alike(copied: Callable[[Any], Any]) -> None:
    flock = env.parallel_env("paper", neighbours=1, uavs=3, duration=6.0)
    flights = env.vector_env("paper", flights=2, neighbours=1, uavs=3, duration=6.0)
    observed = flock.reset(seed=42)[0]
    rows = flights.reset(seed=42)[0]
    actions = np.full((len(rows), 2), 0.3)
    for _ in range(7):
        observed = flock.step({agent: np.full(2, 0.3) for agent in observed})[0]
        flights.step(actions)
    for first, second in ((flock, copied(flock)), (flights, copied(flights))):
        for _ in range(70):  # past the end of the flight
            if first is flock and not flock.agents:
                break
            given = {agent: np.full(2, 0.1) for agent in flock.agents} if first is flock else actions
            for one, two in zip(first.step(given)[:2], second.step(given)[:2], strict=True):
                np.testing.assert_equal(one, two)


def test_a_flight_with_files_is_not_copied(tmp_path: Any) -> None:
    flight = mf.Stepped("paper", uavs=3, duration=2.0, out=tmp_path)
    for copied in COPIES:
        with pytest.raises(mf.BadInput, match="two flights would write its files"):
            copied(flight)
    flight.finish()
