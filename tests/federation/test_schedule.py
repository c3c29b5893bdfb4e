"""The ticks of the rounds and their participants; the account of a round in words, and the hash of the models."""

import numpy as np
import pytest

from meanflock.federation.account import Account, ModelsHash, shares
from meanflock.federation.schedule import Schedule
from meanflock.swarm.scenario import load
from meanflock.swarm.wire.messages import FrameKind, Frames
from tests.agent.nodes import flown
from tests.telemetry import fly


@pytest.mark.parametrize("slots", [1, 3, 8, 40])
@pytest.mark.parametrize("coherence", [5e-5, 0.025, 0.1, 0.125])
@pytest.mark.parametrize("period", [1, 7, 50])
def test_every_round_that_opens_closes_once_in_order_while_it_is_open(
    period: int, coherence: float, slots: int
) -> None:
    radio = (f"radio.coherence_time_s={coherence}", f"radio.latency_threshold_slots={slots}")
    rounds = Schedule(flown(f"federation.period={period}", "federation.fragment=0", *radio, method="mfgfl-h"))
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
    keys = (f"uavs={uavs}", f"federation.fraction={fraction}", f"duration={duration}", "federation.period=20")
    of, some = flown(*keys, method="mfgfl-h"), np.array([0, 2, 3, 11])
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
    rounds, n = Schedule(flown("uavs=10", "federation.fraction=0.3")), 2000
    drawn = np.concatenate([rounds.participants(k) for k in range(n)])
    often = np.bincount(drawn, minlength=10) / n
    assert (np.abs(often - 0.3) < 4 * np.sqrt(0.3 * 0.7 / n)).all()


FIVE = ("uavs=5", "duration=12", 'stop="duration"', "federation.period=50", "federation.fraction=1.0")
CLEAR = "radio.target_snr_db=60"
NEIGHBOURS = "federation.topology=neighbours"
LIARS = ("federation.byzantine_fraction=0.3", "federation.byzantine_kind=huge")


def test_words_name_all_outcomes_and_the_shares_are_read_back() -> None:
    account = Account(participants=10, absent=1, sent=[0, 2, 3, 4, 5, 6])
    links = np.array([[20, uav, 1, 0, slots] for uav, slots in ((0, 2), (2, 2), (3, -8), (4, 7))], dtype=np.int32)
    account.transmit(links, np.array([3, 3, 3, 3]), links[:, 4] > 5)
    account.receive([0, 2], 5)
    account.refused, account.earlier = {2}, 1
    account = Account.restored(account.snapshot())
    words = account.words(" by UAV 1", "fragments")
    assert words == (
        "6 of 10 participants sent, 3 silent, 1 absent, 2 received by UAV 1, 3 lost, 1 late (UAV 4), 1 refused "
        "(UAV 2), 5 of 12 fragments arrived, 1 late from the round before averaged, too"
    )
    assert shares(f"round 7: {words}; averaged by 3 UAVs, 2 isolated") == (7, 5 / 12, 0.3, 1 / 6, 2)
    assert shares("round 7 goes on without the cluster of UAV 3: its head is silent") is None


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        (
            (CLEAR, 'faults=[{kind="kill", tick=10, uavs=[3]}]'),
            "round 1: 4 of 5 participants sent, 1 absent, 4 received by UAV 0; averaged and broadcast, received "
            "by 4 UAVs",
        ),
        (
            (CLEAR, NEIGHBOURS, *LIARS),
            "round 1: 5 of 5 participants sent, 5 received, 2 refused (UAVs 2, 4), 20 of 20 copies arrived; "
            "averaged by 5 UAVs",
        ),
        (
            ("start.spacing=20", "federation.range_m=5", NEIGHBOURS),
            "round 1 is void: no model of another UAV was averaged; 5 of 5 participants sent, 0 received, 5 lost, "
            "5 isolated",
        ),
    ],
)
def test_the_event_of_a_round_is_its_account(settings: tuple[str, ...], expected: str) -> None:
    _, sink = fly(load(None, [*FIVE, *settings], method="mfgfl-h", seed=5))
    event = next(event for event in sink.events if event.kind in ("round", "void"))
    assert event.text == expected
    assert len(event.uavs) == int(expected.split(" of 5")[0].split()[-1])


def test_every_bit_of_the_models_counts_in_their_hash_but_uploads_do_not_where_a_leader_broadcasts() -> None:
    assert fly(load(None, FIVE, method="plan"))[0]["models_sha256"] is None

    def hashed(label: FrameKind, *models: float, number: int = 1) -> str | None:
        hashes = ModelsHash(load(None, FIVE, method="mfgfl-h"))
        for model in models:
            hashes.add([Frames(label, number, np.array([0], np.int32), np.array([[model]], np.float32))])
        return hashes.hexdigest

    two = hashed(FrameKind.GLOBAL, 1.0, 2.0)
    assert two == hashed(FrameKind.GLOBAL, 1.0, 2.0)
    assert two is not None
    others = [
        hashed(FrameKind.GLOBAL, 2.0, 1.0),
        hashed(FrameKind.GLOBAL, 1.0, float(np.nextafter(np.float32(2.0), np.float32(3.0)))),
        hashed(FrameKind.GLOBAL, 1.0, 2.0, number=2),
        hashed(FrameKind.GLOBAL, 1.0),
    ]
    assert len({two, *others}) == 5
    assert hashed(FrameKind.UPLOAD, 1.0) is None
