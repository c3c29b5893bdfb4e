"""Randomness that has a name, and the calendar of the rounds that follows from it."""

import itertools

import numpy as np
import pytest

from swarm import model
from swarm.methods import Method
from swarm.rounds import Rounds
from swarm.scenario import Scenario, load
from swarm.seeds import STREAMS, generator

FEDERATED = [method for method in Method if method.is_federated]


def scenario(*settings: str) -> Scenario:
    return load(None, settings)


# -- seeds --------------------------------------------------------------------------------------------------------


def test_the_same_name_always_gives_the_same_numbers() -> None:
    for stream in STREAMS:
        one, other = generator(7, stream, 3), generator(7, stream, 3)
        np.testing.assert_array_equal(one.standard_normal(100), other.standard_normal(100))


def test_another_seed_stream_or_index_gives_other_numbers() -> None:
    keys = list(itertools.product((0, 1, 2**62), STREAMS, (0, 1, 2)))
    drawn = {tuple(generator(*key).integers(2**63, size=2)) for key in keys}
    assert len(drawn) == len(keys)


def test_streams_are_uncorrelated_within_four_standard_errors() -> None:
    n = 20_000
    drawn = [generator(1, stream).standard_normal(n) for stream in STREAMS]
    for one, other in itertools.combinations(drawn, 2):
        assert abs((one * other).mean()) < 4 / np.sqrt(n)


def test_the_order_of_the_streams_is_part_of_every_result() -> None:
    assert STREAMS[:4] == ("wind", "radio", "participants", "density-fit")


def test_an_unknown_stream_is_refused() -> None:
    with pytest.raises(ValueError, match="tuple"):
        generator(1, "weather")


# -- rounds -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", Method)
def test_rounds_open_every_n0_ticks_but_not_at_take_off(method: Method) -> None:
    rounds = Rounds(scenario(f"method={method}"))
    opened = {tick: rounds.opens(tick) for tick in range(601) if rounds.opens(tick)}
    period = {Method.MFGFL_H: 100, Method.MFGFL_F: 100, Method.MFGFL_HF: 200}.get(method)
    assert opened == ({k * period: k for k in range(1, 600 // period + 1)} if period else {})


@pytest.mark.parametrize("slots", [1, 3, 8, 40])
@pytest.mark.parametrize("coherence", [5e-5, 0.025, 0.1, 0.125])
@pytest.mark.parametrize("period", [1, 7, 50])
def test_every_round_that_opens_closes_once_in_order_while_it_is_open(
    period: int, coherence: float, slots: int
) -> None:
    rounds = Rounds(
        scenario(
            "method=mfgfl-h",
            f"federation.period={period}",
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


def test_a_method_without_rounds_never_has_anything_to_do() -> None:
    for method in set(Method) - set(FEDERATED):
        rounds = Rounds(scenario(f"method={method}", "federation.period=1"))
        assert not any(rounds.opens(t) or rounds.closes(t) or rounds.is_open(t) for t in range(50))


@pytest.mark.parametrize(("uavs", "fraction", "expected"), [(25, 0.8, 20), (1, 0.8, 1), (7, 1.0, 7), (10, 0.01, 1)])
def test_participants_are_the_agreed_number_of_distinct_uavs_ascending(
    uavs: int, fraction: float, expected: int
) -> None:
    rounds = Rounds(scenario(f"uavs={uavs}", f"federation.fraction={fraction}"))
    for number in range(1, 20):
        drawn = rounds.participants(number)
        assert len(drawn) == expected
        assert (np.diff(drawn) > 0).all()
        assert drawn.min() >= 0
        assert drawn.max() < uavs


def test_every_process_draws_the_same_participants_and_every_round_others() -> None:
    one, other = Rounds(scenario()), Rounds(scenario())
    drawn = [tuple(one.participants(k)) for k in (3, 1, 2)]
    assert drawn == [tuple(other.participants(k)) for k in (3, 1, 2)]
    assert len(set(drawn)) == 3
    assert tuple(Rounds(scenario("seed=2")).participants(1)) != drawn[1]


def test_every_uav_is_drawn_equally_often_within_four_standard_errors() -> None:
    rounds, n = Rounds(scenario("uavs=10", "federation.fraction=0.3")), 2000
    drawn = np.concatenate([rounds.participants(k) for k in range(n)])
    often = np.bincount(drawn, minlength=10) / n
    assert (np.abs(often - 0.3) < 4 * np.sqrt(0.3 * 0.7 / n)).all()


# -- what travels -------------------------------------------------------------------------------------------------


def test_a_method_shares_as_many_floats_as_the_paper_counts() -> None:
    floats = {Method.MFGFL_H: 108, Method.MFGFL_F: 138, Method.MFGFL_HF: 246}
    for method in Method:
        part = model.shared(method)
        assert model.shared_floats(method) == floats.get(method, 0)
        assert len(range(model.MODEL_FLOATS)[part]) == floats.get(method, 0)
    assert model.shared(Method.MFGFL_H) == model.VALUE
    assert model.shared(Method.MFGFL_F) == model.DENSITY


def test_only_the_paper_s_federated_methods_have_rounds() -> None:
    assert FEDERATED == [Method.MFGFL_H, Method.MFGFL_F, Method.MFGFL_HF]


def test_who_learns_what_is_as_the_paper_s_algorithms_say() -> None:
    assert {method for method in Method if not method.learns_density} == {Method.HJB, Method.OFFLINE}
    assert {method for method in Method if not method.learns_value} == {Method.OFFLINE}


@pytest.mark.parametrize("clusters", [1, 3])
@pytest.mark.parametrize(("coherence", "slots"), [(5e-5, 8), (0.1, 3)])
@pytest.mark.parametrize("period", [1, 4, 9, 20])
def test_quiet_ticks_are_all_those_of_a_round_in_which_no_agent_sends_a_model(
    period: int, coherence: float, slots: int, clusters: int
) -> None:
    hop = max(1, round(coherence * slots / 0.1))
    if clusters > 1 and period < 2 * hop:
        return  # there is no such scenario
    of = scenario(
        "method=mfgfl-h",
        f"federation.period={period}",
        f"federation.clusters={clusters}",
        f"radio.coherence_time_s={coherence}",
        f"radio.latency_threshold_slots={slots}",
    )
    rounds = Rounds(of)
    for tick in range(500):
        sends = rounds.opens(tick) or rounds.relays(tick)
        quiet = rounds.quiet(tick)
        assert (tick in quiet) == (not sends)
        assert bool(quiet) == (not sends)
        assert not any(rounds.opens(other) or rounds.relays(other) for other in quiet)
        assert {rounds.last(other) for other in quiet} <= {tick // period}
        assert all(rounds.quiet(other) == quiet for other in quiet)
        if quiet and quiet.start:  # nor are they fewer than they could be
            assert rounds.opens(quiet.start - 1) or rounds.relays(quiet.start - 1)
            assert rounds.opens(quiet.stop) or rounds.relays(quiet.stop)


def test_without_rounds_every_tick_is_quiet() -> None:
    rounds = Rounds(scenario("method=mfg"))
    assert all(tick in rounds.quiet(tick) and not rounds.last(tick) for tick in range(500))
    assert not rounds.draw_ahead()


@pytest.mark.parametrize(("duration", "ahead"), [(1.9, 0), (2.0, 1), (20.1, 10), (900.0, 128)])
def test_those_who_take_part_are_drawn_ahead_for_the_flight_or_for_much_of_it(duration: float, ahead: int) -> None:
    of = scenario("method=mfgfl-h", "federation.period=20", f"duration={duration}")
    rounds = Rounds(of, np.array([3]))
    ticks = rounds.draw_ahead()
    assert [rounds.opens(tick) for tick in ticks] == list(range(1, ahead + 1))
    for number in (1, ahead + 1, ahead + 2, 2):
        np.testing.assert_array_equal(rounds.participants(number), Rounds(of).participants(number))


def test_rows_that_take_part_are_the_participants_among_them() -> None:
    of = scenario("method=mfgfl-h", "federation.fraction=0.4")
    uavs = np.array([2, 3, 11, 17, 24])
    rounds = Rounds(of, uavs)
    for number in (1, 2, 9, 30, 4):
        assert uavs[rounds.rows(number)].tolist() == sorted(set(uavs) & set(rounds.participants(number)))
        np.testing.assert_array_equal(rounds.participants(number), Rounds(of).participants(number))
    assert len(Rounds(of).rows(1)) == 0
