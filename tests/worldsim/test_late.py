"""Late nodes, on a clock of the test: held commands in real time; a node that is always late is warned of and lost."""

import itertools
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from meanflock.federation.plan import plan_of
from meanflock.launch.engine import Engine
from meanflock.net import keys
from meanflock.net.bus import Delivery, MemoryBus, MemoryNetwork, Offer
from meanflock.net.members import Member
from meanflock.net.pace import DelayRules
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import load
from meanflock.swarm.wire.messages import Event
from meanflock.worldsim.clocks import factor
from meanflock.worldsim.tick import Row
from tests.memory_swarm import MemorySwarm

RUN = "late"
TICK_S = 0.05  # dt = 0.1 s, twice as fast as the wall clock
PROMPT_S = 0.01


class SlowBus(MemoryBus):
    """The world's bus on a clock that only passes while somebody waits: every answer has its delay."""

    def __init__(self, network: MemoryNetwork) -> None:
        super().__init__(network)
        network.endpoints.append(self)
        self.now = 0.0
        self.delay_s: Callable[[str], float] = lambda node: PROMPT_S
        self.handler = None
        self._coming: list[tuple[float, int, Delivery]] = []

    def subscribe(self, key: str, offer: Offer | None = None) -> None:
        super().subscribe(key)  # nothing is here at once

    def _deliver(self, delivery: Delivery) -> None:
        if delivery.kind != "message":
            self.handler(delivery)
            return
        due = self.now + self.delay_s(keys.node_of(delivery.key))
        self._coming.append((due, len(self._coming), delivery))

    def receive(self, timeout_s: float) -> Delivery | None:
        self._coming.sort(key=lambda entry: entry[:2])
        if self._coming and self._coming[0][0] <= self.now + timeout_s:
            due, _, delivery = self._coming.pop(0)
            self.now = max(self.now, due)
            return delivery
        self.now += timeout_s
        return None


class Flight:
    """Two UAVs or so, each on a node of its own, 20 ticks or so in real time, or in lockstep."""

    def __init__(
        self, realtime: float | None = 2.0, settings: Sequence[str] = (), rows: Sequence[int] = (1, 1)
    ) -> None:
        """`rows`: UAVs of each agent."""
        flown = load(None, [f"uavs={sum(rows)}", "method=mfg", "duration=2", 'stop="duration"', *settings])
        self.events: list[Event] = []
        self.bus: SlowBus

        def make_bus(network: MemoryNetwork) -> SlowBus:
            self.bus = SlowBus(network)
            return self.bus

        self.swarm = MemorySwarm(
            flown,
            RUN,
            uavs_per_node=rows,
            realtime=realtime,
            make_bus=make_bus,
            clock=lambda: self.bus.now,
            leaders=None if plan_of(flown).declared.is_federated else 0,
        )
        self.swarm.sinks.append(self)
        self.world = self.swarm.world
        self.commands: list[np.ndarray] = []

    def write(self, row: Row) -> None:
        self.events += row.events

    def fly(self, delay_s: Callable[[int, str], float] = lambda tick, node: PROMPT_S) -> dict:
        """To the end, each node answering when `delay_s` of tick and node is over."""
        self.bus.delay_s = lambda node: delay_s(self.world.tick, node)
        for _ in self.swarm.fly():
            self.commands.append(self.world.commands.accelerations.copy())
        return self.swarm.finish(lambda: 0.0)


LATE = (3, 4, 9)  # ticks


def test_in_lockstep_a_slow_node_is_asked_again_and_may_answer_twice() -> None:
    def slow(tick: int, node: str) -> float:  # then its second answers come in the same tick, or in the one after
        return {"agent-1": 2.5, "agent-0": 0.1 * tick}[node] if tick in LATE else PROMPT_S

    summary = Flight(realtime=None).fly(slow)
    assert summary["wall_time_s"] > 7.5
    assert (summary["realtime"], summary["held_commands"]) == (None, None)
    assert summary["dropped_messages"] == {}
    assert summary["trajectory_sha256"] == Flight().fly()["trajectory_sha256"]


def test_a_late_node_keeps_its_last_command_and_its_tick_is_counted() -> None:
    flight = Flight()
    summary = flight.fly(lambda tick, node: 1.5 * TICK_S if tick in LATE and node == "agent-1" else PROMPT_S)
    assert summary["held_commands"] == 3
    assert summary["realtime"]["deadline_misses"] == 3
    assert summary["dropped_messages"] == {"stale": 3}
    for tick in range(1, 20):
        held = flight.commands[tick] == flight.commands[tick - 1]
        assert not held[0].all()
        assert held[1].all() == (tick in LATE)
    assert summary["lost"] == 0


def test_a_late_world_reports_its_jitter_and_catches_up() -> None:
    flight = Flight()
    for tick in flight.swarm.fly():
        if tick == 5:
            flight.bus.now += 0.12  # begins tick 5 so late that 6 and 7 are late too
    summary = flight.swarm.finish(lambda: 0.0)
    late = [0.0] * 17 + [20.0, 70.0, 120.0]
    assert summary["realtime"]["tick_start_jitter_ms"] == pytest.approx(
        {"mean": np.mean(late), "p99": np.percentile(late, 99), "max": 120.0}, rel=1e-5
    )
    assert summary["realtime"]["deadline_misses"] == 2  # in tick 7 there is time for an answer
    assert summary["held_commands"] == 4
    assert summary["wall_time_s"] == pytest.approx(20 * TICK_S)


@pytest.mark.parametrize("text", ["0", "-2", "nan", "inf", "fast", ""])
def test_an_invalid_factor_is_bad_input(text: str) -> None:
    with pytest.raises(BadInput, match="--realtime"):
        factor(text)


def test_lockstep_cannot_be_steered() -> None:
    with pytest.raises(BadInput, match="add --realtime"):
        Engine(load(None, ["uavs=1"]), RUN, steer=object())


JUST_IN_TIME_S = 9.5  # the barrier's deadline is 10 s
ANY = "pace.wait_share=1"  # of the wall time: slow replies alone are judged
SHORT = ["pace.slow_ticks=6", ANY]


def fly(delay_s: Callable[[int, str], float], *settings: str, rows: Sequence[int] = (1, 1, 1)) -> dict[str, Any]:
    """A flight in lockstep: the summary, and the events in it that tell of slow and of lost nodes."""
    flight = Flight(None, settings, rows)
    summary = flight.fly(delay_s)
    told = [(event.tick, event.kind, event.text) for event in flight.events]
    return {**summary, "told": [entry for entry in told if entry[1] in ("slow", "lost")]}


def late(delay_s: float, other_s: float = PROMPT_S, *, node: str = "agent-1") -> Callable[[int, str], float]:
    """One node is late in every tick."""
    return lambda _, who: delay_s if who == node else other_s


def test_a_node_that_answers_just_in_time_is_warned_of_then_lost() -> None:
    summary = fly(late(JUST_IN_TIME_S), *SHORT)
    assert summary["ticks"] == 20
    assert (summary["nodes_lost"], summary["lost"]) == (1, 1)
    assert summary["wall_time_s"] < 7 * JUST_IN_TIME_S
    (tick, kind, text), *_ = summary["told"]
    assert (tick, kind) == (2, "slow")
    assert text.startswith("agent-1: 3 replies took more than 2 s")


def test_by_default_some_slow_replies_lose_no_node() -> None:
    summary = fly(late(JUST_IN_TIME_S), ANY)
    assert summary["nodes_lost"] == 0
    assert summary["wall_time_s"] > 19 * JUST_IN_TIME_S
    assert summary["trajectory_sha256"] == fly(late(PROMPT_S))["trajectory_sha256"]


@pytest.mark.parametrize(("stands_still_s", "lost"), [(60.0, 0), (0.0, 1)])
def test_time_in_which_the_machine_stood_still_does_not_count_as_silence(stands_still_s: float, lost: int) -> None:
    flight = Flight(None, [ANY])
    delay_s, receive = (8.0 if stands_still_s else 12.0), flight.bus.receive

    def standing(timeout_s: float) -> Delivery | None:
        if flight.world.flight.tick == 3 and flight.bus.now < stands_still_s:
            flight.bus.now += stands_still_s
        return receive(timeout_s)

    flight.bus.receive = standing
    summary = flight.fly(lambda tick, node: delay_s if tick == 3 and node == "agent-1" else PROMPT_S)
    assert summary["nodes_lost"] == lost


THREE, SIX = (1,) * 3, (1,) * 6
MINUTE = ("duration=6",)
ROUNDS = ("duration=6", "method=mfgfl-h", "federation.period=2")
# When the nodes answer, the UAVs of each agent, settings, and the agents that are lost.
DELAYS: dict[str, tuple[Callable[[int, str], float], Sequence[int], Sequence[str], list[str]]] = {
    "all are slow": (lambda *_: JUST_IN_TIME_S, THREE, SHORT, []),
    "not so many times slower": (late(JUST_IN_TIME_S, JUST_IN_TIME_S / 9), THREE, SHORT, []),
    "below the threshold": (late(1.9), THREE, SHORT, []),
    "1.9 s": (late(1.9), SIX, MINUTE, ["agent-1"]),
    "0.5 s": (late(0.5), SIX, MINUTE, ["agent-1"]),
    "two in turns": (
        lambda tick, node: 1.9 if node == ("agent-4", "agent-1")[tick % 2] else PROMPT_S,
        SIX,
        MINUTE,
        ["agent-4", "agent-1"],
    ),
    "12 s in a minute": (late(0.2), SIX, MINUTE, []),
    "a hiccup": (lambda tick, node: late(JUST_IN_TIME_S)(tick, node) if tick == 9 else PROMPT_S, SIX, MINUTE, []),
    "all in turns": (lambda tick, node: 1.9 if node == f"agent-{tick % 6}" else PROMPT_S, SIX, MINUTE, []),
    "half as quick": (late(1.9, 1.0), SIX, MINUTE, []),
    "the only agent": (late(5.0, 0.25, node="agent-0"), (6,), (*ROUNDS, "pace.slow_ticks=1"), []),
    "five of six UAVs": (late(0.8, 0.04, node="agent-0"), (5, 1), MINUTE, []),
    "the leader": (late(0.8, 0.04, node="leader"), THREE, ROUNDS, []),
}


@pytest.mark.parametrize("name", DELAYS)
def test_an_agent_for_which_alone_the_others_wait_a_fifth_of_the_time_is_lost(name: str) -> None:
    delay_s, rows, settings, lost = DELAYS[name]
    summary = fly(delay_s, *settings, rows=rows)
    assert [text.partition(":")[0] for _, kind, text in summary["told"] if kind == "lost"] == lost
    if len(lost) == 1:
        assert summary["wall_time_s"] < 12.0 + 1.9 + 60 * 2 * PROMPT_S
        assert "s of the last 60 s for it alone" in summary["told"][-1][2]
    assert summary["ticks"] == (20 if settings is SHORT else 60)


AGENTS = {f"agent-{uav}": Member(f"agent-{uav}", "agent", np.array([uav])) for uav in range(3)}


def slow_tick(pace: DelayRules, tick: int, late: str, *training: str) -> list[str]:
    """Verdicts after a tick in which one of three nodes has not answered in time."""
    pace.begin(tick, training)
    for waited_s in (0.1, 3.0):
        pace.look(waited_s, SimpleNamespace(asked=AGENTS, silent=1, missing=[late]))
    return [verdict.node for verdict in pace.overdrawn()]


def test_a_rejoined_node_has_the_same_account_which_is_forgiven_slowly() -> None:
    pace = DelayRules(load(None, SHORT).pace, [], 10.0)
    ticks = itertools.count()
    assert [slow_tick(pace, next(ticks), "agent-1") for _ in range(6)] == [[]] * 5 + [["agent-1"]]
    assert slow_tick(pace, next(ticks), "agent-1.2") == ["agent-1.2"]
    for _ in range(3 * DelayRules.FORGIVEN_TICKS):
        pace.begin(next(ticks))
        assert pace.overdrawn() == []
    assert [slow_tick(pace, next(ticks), "agent-1.3") for _ in range(2)] == [[], ["agent-1.3"]]


def test_a_node_with_a_uav_that_trains_is_not_slow() -> None:
    pace = DelayRules(load(None, SHORT).pace, [], 10.0)
    assert [slow_tick(pace, tick, "agent-1", "agent-1") for tick in range(20)] == [[]] * 20
    assert [slow_tick(pace, tick, "agent-2", "agent-1") for tick in range(20, 26)][-1] == ["agent-2"]
