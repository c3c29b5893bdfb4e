"""States that no UAV can have are not believed; a lie that one could have is."""

from collections.abc import Callable

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from meanflock.agent.controllers.base import plausible
from meanflock.agent.controllers.mean_field import methods
from meanflock.agent.controllers.sharing import base
from meanflock.agent.node import Agent
from meanflock.groundstation.launch import engine as rooms
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire.messages import Act, FrameKind, Frames, Sense
from tests.telemetry import Record, fly

LIAR = 3
Lie = Callable[[np.ndarray], np.ndarray]


def fast(speed: float) -> Lie:
    """The true position and a velocity of that many m/s."""

    def lie(states: np.ndarray) -> np.ndarray:
        return np.concatenate([states[:, :2], np.full_like(states[:, 2:], speed / np.sqrt(2.0))], axis=1)

    return lie


def far(states: np.ndarray) -> np.ndarray:
    return np.concatenate([np.full_like(states[:, :1], 1e7), states[:, 1:]], axis=1)


@pytest.fixture
def lies(monkeypatch: pytest.MonkeyPatch) -> Callable[[Lie], None]:
    """From now on UAV 3 says where it is and how fast, but not truly; it flies honestly."""

    def begin(lie: Lie) -> None:
        class Liar(Agent):
            def act(self, sense: Sense) -> Act:
                act = super().act(sense)
                return msgspec.structs.replace(act, outbox=tuple(map(falsified, act.outbox)))

        def falsified(frames: Frames) -> Frames:
            false = frames.source == LIAR
            if frames.kind != FrameKind.STATE or not false.any():
                return frames
            payload = frames.payload.copy()
            payload[false] = lie(payload[false])
            return Frames(frames.kind, frames.round, frames.source, payload)

        monkeypatch.setattr(rooms, "Agent", Liar)

    return begin


def flown(*settings: str) -> Scenario:
    return load(None, ["uavs=9", "duration=40", *settings], method="hjb")


def refusals(record: Record) -> list[tuple[int, str]]:
    """What was noted of states."""
    return [(event.tick, event.text) for event in record.events if "states of UAV" in event.text]


def believing(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (methods, base):
        monkeypatch.setattr(module, "plausible", lambda scenario: lambda states: np.ones(len(states), bool))


def test_honest_flights_are_what_they_are_without_the_check(monkeypatch: pytest.MonkeyPatch) -> None:
    settings = [(), ("wind.sigma=2",), ("radio.bits_per_float=16",)]
    checked = [fly(flown(*more))[0] for more in settings]
    assert [summary["states_refused"] for summary in checked] == [0, 0, 0]
    believing(monkeypatch)
    for more, summary in zip(settings, checked, strict=True):
        assert fly(flown(*more))[0]["trajectory_sha256"] == summary["trajectory_sha256"]


def test_a_uav_that_claims_an_impossible_speed_is_not_believed_and_disturbs_no_other(
    lies: Callable[[Lie], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    honest, _ = fly(flown())
    lies(fast(1e6))
    (together, record), (alone, _) = fly(flown()), fly(flown(), rows=1)
    assert together["lost"] == honest["lost"] == 0
    assert together["trajectory_sha256"] == alone["trajectory_sha256"]
    assert together["phi_A"] == pytest.approx(honest["phi_A"], rel=0.1)
    # Sent in every tick after the first and received one later; counted once a tick, and one event.
    assert together["states_refused"] == alone["states_refused"] == together["ticks"] - 2
    assert refusals(record) == [(2, f"states of UAV {LIAR} were not believed: no UAV can be so")]
    believing(monkeypatch)
    believed, _ = fly(flown())
    assert believed["phi_A"] > 10 * honest["phi_A"]


def test_a_position_that_no_uav_can_have_reached_is_not_believed(lies: Callable[[Lie], None]) -> None:
    lies(far)
    summary, record = fly(flown("duration=2"))
    assert summary["states_refused"] == 18
    assert len(refusals(record)) == 1


def test_a_lie_that_could_be_true_is_believed_and_does_what_a_uav_of_that_speed_would(
    lies: Callable[[Lie], None],
) -> None:
    lies(fast(99.0))
    summary, record = fly(flown())
    assert (summary["states_refused"], summary["lost"], refusals(record)) == (0, 0, [])


@given(st.floats(0.0, 300.0), st.floats(0.0, 2 * np.pi), st.sampled_from([50.0, 100.0]))
def test_a_state_is_believed_exactly_if_its_speed_is_below_the_bound(
    speed: float, heading: float, bound: float
) -> None:
    check = plausible(load(None, [f"radio.plausible_speed={bound}"]))
    velocity = speed * np.array([np.cos(heading), np.sin(heading)])
    assert not check(np.array([[0, 0, 65536, 0]], dtype=np.int32)).any()  # its square is 0 in 32 bits
    if abs(speed - bound) > 1e-9 * bound:
        assert check(np.array([[150.0, 100.0, *velocity]])).tolist() == [speed < bound]
