"""Steering on a clock of the test: whose commands are replaced, when they are given back, and what is counted."""

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from meanflock.bridge.mavlink import Reader, WireSetpoint
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.stateful import restore, state_of
from meanflock.worldsim.counters import Counters
from meanflock.worldsim.steering import Setpoint, Steered
from meanflock.worldsim.tick import Acts, Senses
from tests.bridge.client import heartbeat, setpoint

WRITER = mavlink.MAVLink(None, srcSystem=250)


class Heard:
    """A port whose clients are the test."""

    def __init__(self) -> None:
        self.coming: list[Setpoint] = []

    def receive(self) -> list[Setpoint]:
        came, self.coming = self.coming, []
        return came

    def tell(self, tick: int, states: np.ndarray, status: np.ndarray) -> None:
        pass


class Hovering:
    """A crew of three UAVs that command nothing."""

    def __init__(self) -> None:
        self.commands = np.zeros((3, 2))

    def answer(self, senses: Senses) -> tuple[Acts, np.ndarray]:
        return Acts(self.commands), np.zeros(3, dtype=bool)


class Flight:
    """A steered crew of three UAVs, with its port, its clock and its events."""

    def __init__(self) -> None:
        self.now = 0.0
        self.port, self.counters, self.crew = Heard(), Counters(), Hovering()
        self.events: list[tuple[str, list[int]]] = []
        self.steered = Steered(self.crew, self.port, self.counters, lambda: self.now)
        self.steered_ticks = 0

    def tick(self, now: float, *came: Setpoint, idle: np.ndarray | None = None) -> list[list[float]]:
        self.now = now
        self.port.coming += came
        all_awake = np.ones(3, dtype=bool)
        nobody = np.zeros(0, dtype=int)
        nothing = [], (), 0, False, b"", False, False, nobody, np.zeros((0, 2)), nobody, 0
        acts, _ = self.steered.answer(Senses(0, np.zeros((3, 4)), all_awake, all_awake, ~all_awake, idle, *nothing))
        assert not self.crew.commands.any()
        self.events += [(note.kind, list(note.uavs)) for note in acts.news]
        self.steered_ticks += acts.steered
        return acts.commands.tolist()


OWN = [0.0, 0.0]
PUSH = Setpoint(1, (3.0, -4.0, 0.0), "127.0.0.1:5000")


def test_a_setpoint_replaces_the_command_of_its_uav_until_a_second_of_silence() -> None:
    steered = Flight()
    assert steered.tick(0.0) == [OWN, OWN, OWN]
    for now in (0.1, 0.6, 1.1):  # the last one is not old enough
        assert steered.tick(now, *[PUSH] * (now == 0.1)) == [OWN, [3.0, -4.0], OWN]
    assert steered.tick(1.2) == [OWN, OWN, OWN]
    assert steered.tick(1.3, PUSH, PUSH._replace(acceleration=(1.0, 0.0))) == [OWN, [1.0, 0.0], OWN]  # the last counts
    assert steered.events == [("steered", [1]), ("released", [1]), ("steered", [1])]
    assert steered.steered_ticks == 4


def test_an_idle_uav_is_not_steered() -> None:
    steered = Flight()
    idle = np.array([False, True, False])
    steered.tick(0.0)
    assert steered.tick(0.0, PUSH, idle=idle) == [OWN, OWN, OWN]
    assert steered.tick(0.1) == [OWN, [3.0, -4.0], OWN]
    assert steered.tick(0.2, idle=idle) == [OWN, OWN, OWN]
    assert steered.events == [("steered", [1]), ("released", [1])]


def test_what_came_before_take_off_is_discarded() -> None:
    steered = Flight()
    steered.port.coming = [PUSH]
    assert steered.tick(0.1) == [OWN, OWN, OWN]
    assert steered.tick(0.2, PUSH) == [OWN, [3.0, -4.0], OWN]


def test_a_resumed_flight_knows_that_it_was_steered() -> None:
    counted, resumed = Counters(), Counters()
    counted.steered = 1
    restore(resumed, state_of(counted))
    assert resumed.steered == 1


def frame(message) -> bytes:
    return message.pack(WRITER)


GOOD = frame(setpoint(2, north=-4.0, east=3.0))


@pytest.mark.parametrize(
    ("datagram", "read"),
    [
        (GOOD, [WireSetpoint(1, (3.0, -4.0, 0.0))]),
        (frame(heartbeat()) + GOOD, [None, WireSetpoint(1, (3.0, -4.0, 0.0))]),
        (setpoint(3, 1.0).pack(WRITER, force_mavlink1=True), [WireSetpoint(2, (0.0, 1.0, 0.0))]),
        (
            frame(setpoint(1, mask=0x0C3F | 0x100)),
            [WireSetpoint(0, (0.0, 0.0, 0.0))],
        ),  # the vertical one may be ignored
        (frame(setpoint(0, 1.0)), ["unknown-system"]),
        (frame(setpoint(4, 1.0)), ["unknown-system"]),
        (frame(setpoint(1, frame=8)), ["wrong-frame"]),
        (frame(setpoint(1, mask=0x0C3F & ~1)), ["wrong-mask"]),  # a position is wanted
        (frame(setpoint(1, mask=0x0C3F | 0x200)), ["wrong-mask"]),  # a force is meant
        (frame(setpoint(1, mask=0x0C3F | 0x40)), ["wrong-mask"]),  # no acceleration to the north
        (frame(setpoint(1, float("nan"))), ["non-finite"]),
        (frame(setpoint(1, 0.0, float("inf"))), ["non-finite"]),
        (frame(setpoint(1, 2e30)), ["non-finite"]),
        (GOOD[:-1], ["malformed"]),
        (GOOD[:-1] + bytes([GOOD[-1] ^ 1]), ["malformed"]),
        (GOOD[:20] + bytes([GOOD[20] ^ 1]) + GOOD[21:], ["malformed"]),
        (GOOD + b"rest", [WireSetpoint(1, (3.0, -4.0, 0.0)), "malformed"]),
        (b"\xfd", ["malformed"]),
        (b"nonsense", ["malformed"]),
        (b"", []),
    ],
)
def test_a_datagram_is_read_frame_by_frame(datagram: bytes, read: list) -> None:
    found = [one.reason if isinstance(one, MessageRejected) else one for one in Reader(3).read(datagram)]
    assert found == read


def test_no_damage_of_a_datagram_is_more_than_an_error() -> None:
    random = np.random.default_rng(7)
    reader = Reader(3)
    for _ in range(3000):
        damaged = bytearray(GOOD + frame(heartbeat()))
        for _ in range(random.integers(1, 4)):
            damaged[random.integers(len(damaged))] = random.integers(256)
        for one in reader.read(bytes(damaged[: random.integers(len(damaged) + 1)])):
            assert one is None or isinstance(one, WireSetpoint | MessageRejected)
