"""Contention for one band: Bianchi's model, drawn backoffs and collisions beside their closed forms, and their ends."""

import math

import numpy as np
import pytest

from meanflock.channel.contention import (
    MOST_SENDERS,
    WINDOW,
    Contention,
    bianchi,
    contend,
    share_collided,
    slots_of_contention,
)
from meanflock.channel.queue import slots_of_link
from meanflock.swarm.errors import BadInput
from meanflock.swarm.seeds import generator
from meanflock.swarm.state import Floats

SLOT = 0.02  # 20 µs in slots of 1 ms
NEEDED, MOST, SUCCESS = 4, 40, 0.8
LAST = NEEDED / SUCCESS  # slots of a message, on average


def drawn(rng: np.random.Generator, frames: list[int], *, acknowledged: bool, lasts: int | None = None) -> Contention:
    """A contention between senders of so many frames each; `lasts`: slots of a frame; None: as on a link."""
    sender = np.arange(len(frames)).repeat(frames)
    chance = slots_of_link(NEEDED, MOST, SUCCESS)
    each = rng.choice(MOST + 1, len(sender), p=chance / chance.sum()) if lasts is None else np.full(len(sender), lasts)
    return contend(rng, sender, each.astype(np.int64), SLOT, acknowledged=acknowledged)


def mean_slots(senders: int, lasts: float) -> float:
    """Σ_{k=n..1} σ (1 − P_tr) / (P_tr P_s) + T_c (1 − P_s) / P_s + T_s, of frames that all last as long."""
    total = 0.0
    for left in range(senders, 0, -1):
        transmits, _ = bianchi(left)
        busy = 1.0 - (1.0 - transmits) ** left
        success = left * transmits * (1.0 - transmits) ** (left - 1) / busy
        total += SLOT * (1.0 - busy) / (busy * success) + lasts * (1.0 - success) / success + lasts
    return total


def test_ten_senders_transmit_and_collide_as_bianchi_has_it() -> None:
    assert bianchi(10) == (pytest.approx(0.052480, abs=5e-7), pytest.approx(0.384404, abs=5e-7))
    assert bianchi(1) == (pytest.approx(2.0 / (WINDOW + 1.0)), pytest.approx(0.0, abs=1e-15))


@pytest.mark.parametrize(("senders", "expected"), [(5, 4.6899), (10, 4.3197), (20, 3.9589), (50, 3.4711)])
def test_the_throughput_is_that_of_the_table_of_ns3(senders: int, expected: float) -> None:
    """Mbit/s of 802.11a at 6 Mbit/s with 12,000 bits a frame, `bianchiResultsEifs` of ns-3's wifi-bianchi. There a
    sender whose next backoff is zero, one in W, transmits again at once."""
    transmits, _ = bianchi(senders)
    busy = 1.0 - (1.0 - transmits) ** senders
    success = senders * transmits * (1.0 - transmits) ** (senders - 1) / busy
    slot, sifs, difs, head, symbol = 9e-6, 16e-6, 34e-6, 20e-6, 4e-6
    data, acknowledgement = (head + symbol * math.ceil(bits / 24) for bits in (22 + 28 * 8 + 48 + 12000, 22 + 14 * 8))
    collision = data + sifs + acknowledgement + difs
    once = 1.0 - 1.0 / WINDOW
    time = (1.0 - busy) * slot + busy * success * (collision / once + slot) + busy * (1.0 - success) * collision
    assert busy * success * 12000 / once / time / 1e6 == pytest.approx(expected, rel=1e-3)


def test_senders_with_many_frames_collide_as_bianchi_has_it() -> None:
    """Until senders have no frame left; the model takes the backoffs of all senders for independent."""
    frames = 3000
    wasted = drawn(generator(1, "access"), [frames] * 10, acknowledged=True, lasts=1).wasted.sum()
    assert wasted / (wasted + 10 * frames) == pytest.approx(bianchi(10)[1], rel=0.04)


@pytest.mark.parametrize("frames", [[1] * 10, [1] * 25, [7] * 10, [7] * 25, [3, 1, 0, 2, 5, 1]])
def test_broadcasts_collide_as_often_as_the_closed_form_says(frames: list[int]) -> None:
    rng, present = generator(2, "access"), [count for count in frames if count]
    sender = np.arange(len(present)).repeat(present)
    lost = np.array([drawn(rng, present, acknowledged=False).collided for _ in range(800)])
    expected = share_collided(np.array(present))
    for one in {0, len(present) - 1}:
        blocks = lost[:, sender == one].mean(axis=1).reshape(40, -1).mean(axis=1)
        assert abs(blocks.mean() - expected[one]) < 4.0 * blocks.std(ddof=1) / len(blocks) ** 0.5


def test_most_broadcasts_of_many_senders_collide() -> None:
    """One frame each collides where any other UAV drew the same backoff of W: 1 − (1 − 1/W)^{n−1}."""
    assert share_collided(np.ones(10, dtype=int))[0] == pytest.approx(1.0 - (15 / 16) ** 9)
    assert share_collided(np.ones(25, dtype=int))[0] == pytest.approx(1.0 - (15 / 16) ** 24)
    assert share_collided(np.full(25, 7))[0] == pytest.approx(0.893, abs=1e-3)
    assert share_collided(np.array([5])).tolist() == pytest.approx([0.0], abs=1e-12)


@pytest.mark.parametrize("senders", [5, 10, 25])
@pytest.mark.parametrize("frames", [1, 7])
def test_contention_costs_unicasts_up_to_twice_a_queue(senders: int, frames: int) -> None:
    rng = generator(3, "access")
    took = np.mean([drawn(rng, [frames] * senders, acknowledged=True).end for _ in range(200)])
    assert 1.1 < took / (senders * frames * LAST) < 1.8
    if frames == 1:
        assert 0.72 < mean_slots(senders, LAST) / took < 1.06


@pytest.mark.parametrize("senders", [2, 10, 25, MOST_SENDERS])
@pytest.mark.parametrize(("frames", "turns"), [(1, 1), (6, 1), (6, 6)])
def test_a_contention_hardly_ever_takes_longer_than_is_planned_for_it(senders: int, frames: int, turns: int) -> None:
    rng, chance = generator(4, "access"), slots_of_link(NEEDED, MOST, SUCCESS)
    planned = slots_of_contention(chance, 1, senders, frames, SLOT, acknowledged=True, turns=turns)
    each = [frames // turns] * senders
    took = np.array([sum(drawn(rng, each, acknowledged=True).end for _ in range(turns)) for _ in range(100)])
    assert took.max() < planned < 1.6 * took.max() + 40.0


def test_frames_that_are_sent_once_take_a_queue_and_their_backoffs_at_most() -> None:
    rng, chance = generator(5, "access"), slots_of_link(NEEDED, MOST, SUCCESS)
    planned = slots_of_contention(chance, 1, 25, 2, SLOT, acknowledged=False)
    assert max(drawn(rng, [2] * 25, acknowledged=False).end for _ in range(200)) < planned
    alone = slots_of_contention(chance, 1, 1, 7, SLOT, acknowledged=True)
    found = [drawn(rng, [7], acknowledged=True) for _ in range(200)]
    assert max(one.end for one in found) <= alone
    assert not any(one.wasted.any() or one.collided.any() for one in found)


def test_every_acknowledged_frame_gets_through_alone_in_the_order_of_its_sender() -> None:
    found = drawn(generator(6, "access"), [3] * 8, acknowledged=True, lasts=5)
    begin: Floats = np.sort(found.begin)
    assert not found.collided.any()
    assert np.diff(begin).min() > 5.0 - 1e-9
    assert found.end == pytest.approx(begin[-1] + 5.0)
    assert (np.diff(found.begin.reshape(8, 3), axis=1) > 0).all()
    assert found.wasted.sum() >= 10
    assert found.wasted.sum() % 5 == 0
    again = drawn(generator(6, "access"), [3] * 8, acknowledged=True, lasts=5)
    assert again.begin.tolist() == found.begin.tolist()


def test_more_senders_than_were_measured_are_refused_with_their_number() -> None:
    chance = slots_of_link(NEEDED, MOST, SUCCESS)
    with pytest.raises(BadInput, match=rf"{MOST_SENDERS + 1} UAVs send .* known up to {MOST_SENDERS}"):
        slots_of_contention(chance, 1, MOST_SENDERS + 1, 1, SLOT, acknowledged=True)
    assert slots_of_contention(chance, 1, MOST_SENDERS + 1, 1, SLOT, acknowledged=False)
