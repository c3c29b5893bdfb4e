"""Real time on a clock of the test: late commands are held and counted, and late ticks are reported."""

import numpy as np
import pytest

from meanflock.swarm.errors import BadInput
from meanflock.worldsim.summary import factor
from tests.worldsim.late import PROMPT_S, TICK_S, Flight


def test_in_lockstep_a_slow_node_is_asked_again_and_may_answer_twice() -> None:
    flight = Flight(realtime=None)

    def slow(tick: int) -> None:  # then its second answers come in the same tick, or in the one after
        late = {"agent-1": 2.5, "agent-0": 0.1 * tick} if tick in (3, 4, 9) else {}
        flight.bus.delay_s = lambda node: late.get(node, PROMPT_S)

    summary = flight.fly(slow)
    assert summary["wall_time_s"] > 7.5
    assert (summary["realtime"], summary["held_commands"]) == (None, None)
    assert summary["dropped_messages"] == {}
    assert summary["trajectory_sha256"] == Flight().fly()["trajectory_sha256"]


def test_a_late_node_keeps_its_last_command_and_its_tick_is_counted() -> None:
    flight = Flight()

    def slow(tick: int) -> None:
        late = {"agent-1": 1.5 * TICK_S} if tick in (3, 4, 9) else {}
        flight.bus.delay_s = lambda node: late.get(node, PROMPT_S)

    summary = flight.fly(slow)
    assert summary["held_commands"] == 3
    assert summary["realtime"]["deadline_misses"] == 3
    assert summary["dropped_messages"] == {"stale": 3}
    for tick in range(1, 20):
        held = flight.commands[tick] == flight.commands[tick - 1]
        assert not held[0].all()
        assert held[1].all() == (tick in (3, 4, 9))
    assert summary["lost"] == 0


def test_a_late_world_reports_its_jitter_and_catches_up() -> None:
    flight = Flight()

    def stall(tick: int) -> None:
        if tick == 5:
            flight.bus.now += 0.12  # begins tick 5 so late that 6 and 7 are late too

    summary = flight.fly(stall)
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
