"""Transmissions one after another in one band: how long a transmission lasts, and how long a queue of them."""

import numpy as np

from meanflock.channel import link
from meanflock.swarm.state import Floats

LATE = 1e-3  # probability that a queue takes longer than is planned for it
_MOST_SLOTS = 2**24  # of the longest queue whose distribution is computed


def slots_of_link(needed: int, most: int, success: float) -> Floats:
    """Distribution of the slots min(D, D_M) of a message on a link, (D_M + 1,).

    D is negative binomial: slots until `needed` of them carried something, each with probability `success`.
    """
    chance = np.zeros(most + 1)
    if needed <= most and success > 0.0:
        fails = np.arange(1, most - needed + 1)
        ways = np.concatenate([[0.0], np.cumsum(np.log((needed + fails - 1.0) / fails))])  # ln (d−1 choose K−1)
        with np.errstate(divide="ignore"):
            tail = fails * np.log1p(-success)
        chance[needed:] = np.exp(needed * np.log(success) + ways + np.concatenate([[0.0], tail]))
    chance[most] += max(0.0, 1.0 - chance.sum())
    return chance


def success_of(needed: int, most: int, mean: float) -> float:
    """The probability that a slot carries something with which a message takes `mean` slots on average; 0 to 1."""
    low, high = 0.0, 1.0
    for _ in range(40):
        middle = np.array([0.5 * (low + high)])
        takes = link.delivered_slots(needed, most, middle) + most * link.lost(needed, most, middle)
        low, high = (float(middle[0]), high) if takes[0] > mean else (low, float(middle[0]))
    return high


def mean_slots(chance: Floats, links: int) -> float:
    """Mean slots of a transmission over so many links, each with the distribution `chance` (D + 1,) of its slots."""
    lasts = np.diff(np.minimum(np.cumsum(chance), 1.0) ** links, prepend=0.0)
    return float(np.arange(len(chance)) @ lasts)


def slots_of_queue(chance: Floats, links: int, transmissions: int, late: float = LATE) -> int:
    """Least slots of which a queue takes more with probability `late` at most.

    Args:
        chance: (D + 1,) distribution of the slots on a link. links: of a transmission, which lasts as its slowest one.
    """
    most = len(chance) - 1
    lasts = np.diff(np.minimum(np.cumsum(chance), 1.0) ** links, prepend=0.0)
    total = transmissions * most
    if total > _MOST_SLOTS:
        return total
    size = 1 << total.bit_length()
    queue = np.cumsum(np.fft.irfft(np.fft.rfft(lasts, size) ** transmissions, size)[: total + 1])
    return int(np.argmax(queue >= 1.0 - late))
