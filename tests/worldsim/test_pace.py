"""Nodes that answer just in time, tick after tick, are warned of and then lost; on a clock of the test."""

from collections.abc import Callable, Sequence
from typing import Any, ClassVar

import numpy as np
import pytest

from meanflock.swarm.net.bus import Delivery
from meanflock.swarm.scenario import load
from meanflock.worldsim.members import Member
from meanflock.worldsim.waiting import Pace
from tests.worldsim.late import PROMPT_S, Flight

JUST_IN_TIME_S = 9.5  # the barrier's deadline is 10 s
ANY = "pace.wait_share=1"  # of the wall time: slow replies alone are judged
SHORT = ["pace.slow_ticks=6", ANY]


def fly(
    delay_s: Callable[[int, str], float], *settings: str, realtime: float | None = None, rows: Sequence[int] = (1, 1, 1)
) -> dict[str, Any]:
    """Some nodes, each answering when `delay_s` of tick and node is over; the summary, and the events in it."""
    flight = Flight(realtime, settings, rows)

    def slow(tick: int) -> None:
        flight.bus.delay_s = lambda node: delay_s(tick, node)

    heard: list[tuple[int, str, str]] = []
    begin = flight.world._reporter.begin

    def begin_and_tell(block: int, first_tick: int) -> None:
        heard.extend((event.tick, event.kind, event.text) for event in flight.world._reporter.events)
        begin(block, first_tick)

    flight.world._reporter.begin = begin_and_tell  # type: ignore[method-assign]
    summary = flight.fly(slow)
    told = heard + [(event.tick, event.kind, event.text) for event in flight.world.flight.events]
    return {**summary, "told": [entry for entry in told if entry[1] in ("slow", "lost")]}


def drip(_tick: int, node: str) -> float:
    return JUST_IN_TIME_S if node == "agent-1" else PROMPT_S


def test_a_node_that_answers_just_in_time_is_warned_of_then_lost() -> None:
    summary = fly(drip, *SHORT)
    assert summary["ticks"] == 20
    assert (summary["nodes_lost"], summary["lost"]) == (1, 1)
    assert summary["wall_time_s"] < 7 * JUST_IN_TIME_S
    (tick, kind, text), *_ = summary["told"]
    assert (tick, kind) == (2, "slow")
    assert text.startswith("agent-1: 3 replies took more than 2 s")


def test_by_default_some_slow_replies_lose_no_node() -> None:
    summary = fly(drip, ANY)
    assert summary["nodes_lost"] == 0
    assert summary["wall_time_s"] > 19 * JUST_IN_TIME_S
    assert summary["trajectory_sha256"] == fly(lambda tick, node: PROMPT_S)["trajectory_sha256"]


@pytest.mark.parametrize(("stands_still_s", "lost"), [(60.0, 0), (0.0, 1)])
def test_time_in_which_the_machine_stood_still_does_not_count_as_silence(stands_still_s: float, lost: int) -> None:
    flight = Flight(None, [ANY])
    delay_s, receive = (8.0 if stands_still_s else 12.0), flight.bus.receive

    def silent(tick: int) -> None:
        flight.bus.delay_s = lambda node: delay_s if tick == 3 and node == "agent-1" else PROMPT_S

    def standing(timeout_s: float) -> Delivery | None:
        if flight.world.flight.tick == 3 and flight.bus.now < stands_still_s:
            flight.bus.now += stands_still_s
        return receive(timeout_s)

    flight.bus.receive = standing  # type: ignore[method-assign]
    assert flight.fly(silent)["nodes_lost"] == lost


def late(delay_s: float, other_s: float = PROMPT_S, *, node: str = "agent-1") -> Callable[[int, str], float]:
    """One node is late in every tick."""
    return lambda _, who: delay_s if who == node else other_s


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
        lambda tick, node: 1.9 if node in ("agent-1", "agent-4") and tick % 2 == int(node[-1]) % 2 else PROMPT_S,
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


class Nobody:
    """A barrier at which one of three nodes has not answered."""

    asked: ClassVar = {f"agent-{uav}": Member(f"agent-{uav}", "agent", np.array([uav])) for uav in range(3)}
    silent = 1

    def __init__(self, late: str) -> None:
        self.missing = [late]


def slow_tick(pace: Pace, late: str) -> list[str]:
    pace.begin()
    pace.look(0.1, Nobody(late))  # type: ignore[arg-type]
    pace.look(3.0, Nobody(late))  # type: ignore[arg-type]
    return [verdict.node for verdict in pace.overdrawn()]


def test_a_rejoined_node_has_the_same_account_which_is_forgiven_slowly() -> None:
    pace = Pace(load(None, SHORT).pace, lambda kind, text: None, 10.0)
    assert [slow_tick(pace, "agent-1") for _ in range(6)] == [[]] * 5 + [["agent-1"]]
    assert slow_tick(pace, "agent-1.2") == ["agent-1.2"]
    for _ in range(3 * Pace.FORGIVEN_TICKS):
        pace.begin()
        assert pace.overdrawn() == []
    assert [slow_tick(pace, "agent-1.3") for _ in range(2)] == [[], ["agent-1.3"]]
