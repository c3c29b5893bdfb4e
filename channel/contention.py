"""Contention for one band, as in the DCF of IEEE 802.11: drawn backoffs and collisions, and their closed forms.

The model is Bianchi's (IEEE JSAC 18(3), 2000). Time goes in contention slots. A sender counts a random backoff down,
one a slot, and transmits at zero. Two senders that transmit in the same slot collide, and the band is busy until the
longest of their frames is over. An acknowledged frame is sent again from twice the window until it gets through; other
frames are lost. All senders hear one another.
"""

import math
from functools import lru_cache
from heapq import heapify, heappop, heappush
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meanflock.channel.queue import LATE, slots_of_queue
from meanflock.swarm.errors import BadInput
from meanflock.swarm.state import Floats

WINDOW = 16  # W, values of the first backoff
DOUBLINGS = 6  # m, after which the window stays 2^m W
MOST_SENDERS = 50  # of acknowledged frames, up to which `slots_of_contention` was measured
_MARGIN = 1.25  # factor on its bound; the longest backoff is added, too
_NEGLIGIBLE = 1e-15  # probability
_RATES = np.geomspace(1e-2, 1e3, 200)  # at which the bound is tried, over the mean
_BISECTIONS = 60


class Contention(NamedTuple):
    """Outcome of a contention between the senders of T frames.

    begin: (T,) slots of θ from the start until each frame is transmitted as it counts: the time that gets through, or
    the collision. collided: (T,) whether the frame is lost. end: until the last transmission is over. wasted: (T,)
    slots that each was sent in collisions before it got through.
    """

    begin: Floats
    collided: NDArray[np.bool_]
    end: float
    wasted: NDArray[np.int64]


def contend(
    rng: np.random.Generator, sender: NDArray[np.intp], lasts: NDArray[np.int64], slot: float, *, acknowledged: bool
) -> Contention:
    """Lets the senders of some frames contend until no frame is left.

    Args:
        sender: (T,) the sender of each frame, ascending. It sends its frames one after another. lasts: (T,) slots of θ
            that each is on the air. slot: σ, of the contention, in slots of θ. acknowledged: whether frames that
            collide are sent again.
    """
    begin, collided = np.zeros(len(sender)), np.zeros(len(sender), dtype=bool)
    first = np.flatnonzero(np.diff(sender, prepend=-1))
    end = np.append(first[1:], len(sender)).tolist()
    frame, doublings = first.tolist(), [0] * len(first)
    turns = list(zip(rng.integers(0, WINDOW, len(first)).tolist(), range(len(first)), strict=True))
    heapify(turns)  # contention slot and number of the sender that transmits in it
    wasted = np.zeros(len(sender), dtype=np.int64)
    time, past = 0.0, -1
    while turns:
        now = turns[0][0]
        at_once = []
        while turns and turns[0][0] == now:
            at_once.append(heappop(turns)[1])
        time += (now - past - 1) * slot
        past = now
        collides = len(at_once) > 1
        sent = [frame[one] for one in at_once]
        begin[sent] = time
        longest = int(lasts[sent].max())
        time += longest
        for one in at_once:
            if collides and acknowledged:
                doublings[one] = min(doublings[one] + 1, DOUBLINGS)
                wasted[frame[one]] += lasts[frame[one]]
            else:
                collided[frame[one]] = collides
                doublings[one] = 0
                frame[one] += 1
            if frame[one] < end[one]:
                heappush(turns, (now + 1 + int(rng.integers(0, WINDOW << doublings[one])), one))
    return Contention(begin, collided, time, wasted)


@lru_cache(maxsize=1024)
def bianchi(senders: int) -> tuple[float, float]:
    """τ and p of n senders that always have a frame: the probability that one transmits in a contention slot, and that
    it collides then. τ = 2 / (1 + W + p W Σ_{i<m} (2p)^i), p = 1 − (1 − τ)^{n−1}.
    """
    low, high = 0.0, 1.0
    for _ in range(_BISECTIONS):
        collides = 0.5 * (low + high)
        backoffs = sum((2.0 * collides) ** stage for stage in range(DOUBLINGS))
        transmits = 2.0 / (1.0 + WINDOW + collides * WINDOW * backoffs)
        below = 1.0 - (1.0 - transmits) ** (senders - 1) > collides
        low, high = (collides, high) if below else (low, collides)
    return transmits, collides


def slots_of_contention(
    chance: Floats,
    receivers: int,
    senders: int,
    frames: int,
    slot: float,
    *,
    acknowledged: bool,
    turns: int = 1,
) -> int:
    """Slots of θ of which a contention takes more with probability `LATE` at most.

    Frames that are sent once take a queue's time, and their backoffs at most. Acknowledged frames are bounded by
    Chernoff's inequality: with k senders left, a frame takes idle slots, collisions and its own time, on average
    σ (1 − P_tr) / (P_tr P_s) + T_c (1 − P_s) / P_s + T_s. A margin is added because windows, which this takes to be
    stationary, grow late and stay long while senders finish.

    Args:
        chance: (D + 1,) distribution of the slots on a link. receivers: of a frame, which lasts as its slowest link.
            senders: n, each with so many `frames`. slot: σ, in slots of θ. turns: contentions, one after another, over
            which the frames are spread.

    Raises:
        BadInput: there are more senders than the bound was measured with.
    """
    if senders == 1 or not acknowledged:
        return slots_of_queue(chance, receivers, senders * frames) + math.ceil(frames * WINDOW * slot)
    if senders > MOST_SENDERS:
        raise BadInput(
            f"scenario: `radio.access` is csma, and {senders} UAVs send acknowledged frames at once; how long they "
            f"contend is known up to {MOST_SENDERS}: fly fewer UAVs, lower `federation.fraction`, or take tdma"
        )
    slots = np.flatnonzero(chance > _NEGLIGIBLE)
    chance = chance[slots]
    rates = _RATES / (senders * frames * (slot + float(slots @ chance)))
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        growth = np.exp(np.outer(rates, slots))
        total = np.full(len(rates), -math.log(LATE))
        for left in range(senders, 0, -1):
            times = turns + (frames - turns) * senders * (left == senders)
            total += times * _log_moments(chance, growth, left, np.exp(rates * slot))
    return math.ceil(_MARGIN * float(np.min(total / rates)) + (WINDOW << DOUBLINGS) * slot)


def _log_moments(chance: Floats, growth: Floats, senders: int, idle_growth: Floats) -> Floats:
    """ln E[e^{rT}] of the time T until one of so many senders gets a frame through, (R,); not finite where infinite.

    Args:
        growth: (R, len(chance)), e^{rd} for each rate r and number d of slots. idle_growth: (R,), the same for σ.
    """
    transmits, _ = bianchi(senders)
    idle = (1.0 - transmits) ** senders
    success = senders * transmits * (1.0 - transmits) ** (senders - 1)
    within = np.minimum(np.cumsum(chance), 1.0)
    several = (1.0 - transmits + transmits * within) ** senders - idle - success * within  # P[collide, none is longer]
    collision = np.diff(np.maximum.accumulate(several), prepend=0.0)
    ends = 1.0 - idle * idle_growth - growth @ collision
    return np.log(np.where(ends > 0.0, success * (growth @ chance) / ends, np.inf))


def share_collided(frames: NDArray[np.intp]) -> Floats:
    """Expected share of the frames of each sender that collide, where none is acknowledged; `frames`: (S,) of each.

    No backoff depends on another sender then: a UAV transmits its k-th frame in a contention slot that is a sum of k
    backoffs of its own, so the slots of all UAVs are independent.
    """
    kinds, of_sender, times = np.unique(frames, return_inverse=True, return_counts=True)
    return _shares(tuple(kinds.tolist()), tuple(times.tolist()))[of_sender]


@lru_cache(maxsize=1024)
def _shares(kinds: tuple[int, ...], times: tuple[int, ...]) -> Floats:
    """The same for senders of each kind, which so many `times` send so many frames."""
    length = WINDOW * max(kinds)
    transmits = np.zeros((len(kinds), length))
    step, one = np.full(WINDOW, 1.0 / WINDOW), np.ones(1)
    for number in range(1, max(kinds) + 1):
        one = np.convolve(one, step)  # of the sum of backoffs; the earlier frames take a slot each
        transmits[np.array(kinds) >= number, number - 1 : number - 1 + len(one)] += one
    silent = np.prod((1.0 - transmits) ** np.array(times)[:, None], axis=0)
    alone = (transmits * silent / (1.0 - transmits)).sum(axis=1)
    return 1.0 - alone / np.array(kinds)
