"""Slow drip, on a clock of the test's own: who answers just in time, tick after tick, is warned of and then lost."""

from collections.abc import Callable
from typing import Any

import pytest

from meanflock.swarm.scenario import load
from meanflock.worldsim.pace import Pace
from tests.worldsim.late import PROMPT_S, Flight

JUST_IN_TIME_S = 9.5  # the barrier's deadline is 10 s
SHORT = ["pace.slow_ticks=6"]


def fly(delay_s: Callable[[int, str], float], *settings: str, realtime: float | None = None) -> dict[str, Any]:
    """Three nodes, each answering when `delay_s` of tick and node is over; the summary, and the events in it."""
    flight = Flight(realtime, settings, uavs=3)

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


def test_who_answers_just_in_time_is_warned_of_then_lost_and_the_flight_goes_on() -> None:
    summary = fly(drip, *SHORT)
    assert summary["ticks"] == 20
    assert (summary["nodes_lost"], summary["lost"]) == (1, 1)
    assert summary["wall_time_s"] < 7 * JUST_IN_TIME_S
    (tick, kind, text), *_ = summary["told"]
    assert (tick, kind) == (2, "slow")
    assert text.startswith("agent-1: 3 replies took more than 2 s")


def test_by_default_a_bad_minute_costs_nobody_anything() -> None:
    summary = fly(drip)
    assert summary["nodes_lost"] == 0
    assert summary["wall_time_s"] > 19 * JUST_IN_TIME_S
    assert summary["trajectory_sha256"] == fly(lambda tick, node: PROMPT_S)["trajectory_sha256"]


@pytest.mark.parametrize(
    "delay_s",
    [
        lambda tick, node: JUST_IN_TIME_S,
        lambda tick, node: JUST_IN_TIME_S if node == "agent-1" else JUST_IN_TIME_S / 9,
        lambda tick, node: 1.9 if node == "agent-1" else PROMPT_S,
        lambda tick, node: JUST_IN_TIME_S if node == f"agent-{tick % 3}" and tick < 15 else PROMPT_S,
    ],
    ids=["all are slow", "not so many times slower", "below the threshold", "in turns"],
)
def test_who_is_slow_with_others_or_seldom_is_not_lost(delay_s: Callable[[int, str], float]) -> None:
    summary = fly(delay_s, *SHORT)
    assert summary["nodes_lost"] == 0
    assert [kind for _, kind, _ in summary["told"]] in ([], ["slow"] * 3)


def test_in_real_time_nobody_waits_and_nobody_is_lost_for_it() -> None:
    summary = fly(drip, "pace.slow_ticks=1", realtime=2.0)
    assert summary["nodes_lost"] == 0
    assert summary["held_commands"] > 0


class Nobody:
    """A barrier at which one of three nodes has not answered."""

    asked = dict.fromkeys(("agent-0", "agent-1", "agent-2"))
    silent = 1

    def __init__(self, late: str) -> None:
        self.missing = [late]


def slow_tick(pace: Pace, late: str) -> list[str]:
    pace.begin()
    pace.look(0.1, Nobody(late))  # type: ignore[arg-type]
    pace.look(3.0, Nobody(late))  # type: ignore[arg-type]
    return [name for name, _ in pace.overdrawn()]


def test_another_life_has_the_same_account_and_one_reply_in_a_hundred_ticks_is_forgiven() -> None:
    pace = Pace(load(None, SHORT).pace, lambda kind, text: None)
    assert [slow_tick(pace, "agent-1") for _ in range(6)] == [[]] * 5 + [["agent-1"]]
    assert slow_tick(pace, "agent-1.2") == ["agent-1.2"]
    for _ in range(3 * Pace.FORGIVEN_TICKS):
        pace.begin()
        assert pace.overdrawn() == []
    assert [slow_tick(pace, "agent-1.3") for _ in range(2)] == [[], ["agent-1.3"]]


@pytest.mark.parametrize("table", ["pace.slow_s=0", "pace.slow_s=inf", "pace.slow_factor=0.5", "pace.slow_ticks=0"])
def test_a_pace_that_makes_no_sense_is_bad_input(table: str) -> None:
    with pytest.raises(Exception, match="slow_"):
        load(None, [table])


def test_the_pace_counts_in_the_hash_only_where_it_is_not_the_default() -> None:
    assert load(None, ["pace.slow_ticks=50"]).sha256() == load(None).sha256()
    assert load(None, SHORT).sha256() != load(None).sha256()
