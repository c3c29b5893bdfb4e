"""The ticks at which rounds open and close, their participants, and the models that travel."""

import numpy as np
import pytest

from meanflock.federation.schedule import Schedule
from meanflock.swarm.scenario import Scenario, load


def scenario(*settings: str) -> Scenario:
    return load(None, settings)


@pytest.mark.parametrize("slots", [1, 3, 8, 40])
@pytest.mark.parametrize("coherence", [5e-5, 0.025, 0.1, 0.125])
@pytest.mark.parametrize("period", [1, 7, 50])
def test_every_round_that_opens_closes_once_in_order_while_it_is_open(
    period: int, coherence: float, slots: int
) -> None:
    rounds = Schedule(
        scenario(
            "method=mfgfl-h",
            f"federation.period={period}",
            "federation.fragment=0",
            f"radio.coherence_time_s={coherence}",
            f"radio.latency_threshold_slots={slots}",
        )
    )
    ticks = range(500)
    opened = [(tick, rounds.opens(tick)) for tick in ticks if rounds.opens(tick)]
    closed = [(tick, rounds.closes(tick)) for tick in ticks if rounds.closes(tick)]
    assert [number for _, number in closed] == list(range(1, len(closed) + 1))
    waits = {end - begin for (begin, _), (end, _) in zip(opened, closed, strict=False)}
    assert waits == {max(1, int(np.ceil(np.round(slots * coherence / 0.1, 9))))}
    wanted = {tick for (begin, _), (end, _) in zip(opened, closed, strict=False) for tick in range(begin + 1, end + 1)}
    assert {tick for tick in range(max(wanted) + 1) if rounds.is_open(tick)} == wanted


@pytest.mark.parametrize(("uavs", "fraction", "expected"), [(25, 0.8, 20), (1, 0.8, 1), (7, 1.0, 7), (10, 0.01, 1)])
@pytest.mark.parametrize("duration", [2.0, 900.0])
def test_every_node_draws_the_agreed_number_of_uavs_ascending_before_or_when_they_are_needed(
    uavs: int, fraction: float, expected: int, duration: float
) -> None:
    of = scenario("method=mfgfl-h", f"uavs={uavs}", f"federation.fraction={fraction}", f"duration={duration}")
    of, some = of.replace(**{"federation.period": 20}), np.array([0, 2, 3, 11])
    ahead, rows, late = Schedule(of, some), Schedule(of, some), Schedule(of)
    ahead.draw_ahead()
    for number in (1, 10, 11, 128, 129, 130, 2):
        drawn = late.participants(number)
        assert len(drawn) == expected
        assert (np.diff(drawn, prepend=-1, append=uavs) > 0).all()
        for other in (ahead, rows):
            np.testing.assert_array_equal(drawn, other.participants(number))
            assert some[other.rows(number)].tolist() == sorted(set(some) & set(drawn))
    assert len(late.rows(1)) == 0


def test_every_uav_is_drawn_equally_often_within_four_standard_errors() -> None:
    rounds, n = Schedule(scenario("uavs=10", "federation.fraction=0.3")), 2000
    drawn = np.concatenate([rounds.participants(k) for k in range(n)])
    often = np.bincount(drawn, minlength=10) / n
    assert (np.abs(often - 0.3) < 4 * np.sqrt(0.3 * 0.7 / n)).all()
