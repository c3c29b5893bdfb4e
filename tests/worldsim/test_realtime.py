"""Real time on a clock of the test's own: who is late is held and counted, and the ticks say how late they began."""

import numpy as np
import pytest

from meanflock.groundstation.launch.engine import Engine
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import load
from meanflock.swarm.wire.messages import SWARM_COLUMNS, Telemetry
from meanflock.worldsim.timing import Schedule, factor
from tests.worldsim.late import PROMPT_S, RUN, TICK_S, Flight


def test_in_time_nothing_is_held_and_every_tick_begins_when_it_should() -> None:
    summary = Flight().fly()
    assert summary["held_commands"] == 0
    assert summary["dropped_messages"] == {}
    assert summary["realtime"]["factor"] == 2.0
    assert summary["realtime"]["deadline_misses"] == 0
    assert summary["realtime"]["tick_start_jitter_ms"] == pytest.approx({"mean": 0, "p99": 0, "max": 0}, abs=1e-6)
    assert summary["wall_time_s"] == pytest.approx(20 * TICK_S)
    assert summary["real_time_factor"] == pytest.approx(2.0)


def test_in_lockstep_who_is_asked_again_because_it_is_slow_may_answer_twice() -> None:
    flight = Flight(realtime=None)

    def slow(tick: int) -> None:  # then its second answers come in the same tick, or in the one after
        late = {"agent-1": 2.5, "agent-0": 0.1 * tick} if tick in (3, 4, 9) else {}
        flight.bus.delay_s = lambda node: late.get(node, PROMPT_S)

    summary = flight.fly(slow)
    assert summary["wall_time_s"] > 7.5
    assert summary["dropped_messages"] == {}
    assert summary["trajectory_sha256"] == Flight().fly()["trajectory_sha256"]


def test_a_late_command_is_held_over_and_its_tick_counted() -> None:
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


def test_a_world_that_is_late_itself_says_so_catches_up_and_hears_everyone_again() -> None:
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


def test_what_is_there_already_is_heard_however_late_the_tick_began() -> None:
    flight = Flight()
    flight.bus.delay_s = lambda node: 0.0

    def stall(tick: int) -> None:
        flight.bus.now += 10 * TICK_S

    assert flight.fly(stall)["realtime"]["deadline_misses"] == 0


def test_telemetry_says_how_many_are_held_while_it_flies() -> None:
    told: list[Telemetry] = []

    class Keep:
        def write(self, block: Telemetry) -> None:
            told.append(block)

    flown = load(None, ["uavs=2", "method=mfg", "duration=1", 'stop="duration"'])
    engine = Engine(flown, RUN, sinks=[Keep()], realtime=100.0)
    counters = engine.world.counters
    for tick in engine.fly():
        if tick == 5:
            counters.late(3)
    summary = engine.world.finish()
    columns = np.concatenate([block.swarm for block in told])[:, -2:]
    assert SWARM_COLUMNS[-2:] == ("held_commands", "deadline_misses")
    assert columns[5].tolist() == [0, 0]
    assert (columns[6:] - columns[5]).min() >= 1
    assert columns[-1].tolist() == [summary["held_commands"], summary["realtime"]["deadline_misses"]]
    assert not engine.world.outbox.waiting


def test_in_lockstep_there_is_no_real_time_to_report() -> None:
    engine = Engine(load(None, ["uavs=2", "duration=1"]), RUN)
    for _ in engine.fly():
        pass
    summary = engine.world.finish()
    assert summary["realtime"] is None
    assert summary["held_commands"] is None


def test_a_schedule_nobody_began_knows_no_jitter() -> None:
    assert Schedule(1.0, 0.1).jitter_ms() == {"mean": None, "p99": None, "max": None}


@pytest.mark.parametrize("text", ["0", "-2", "nan", "inf", "fast", ""])
def test_a_factor_that_is_none_is_named(text: str) -> None:
    with pytest.raises(BadInput, match="--realtime"):
        factor(text)
