"""What a batch came to: a line for the record of every link, and what the bill needs to know of all of them."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from channel import kernel
from channel.link import Transmission
from channel.links import Links


class Account(NamedTuple):
    """Of a batch over K links by radio.

    record: (K, 5) int32 [tick, source, target, kind, slots], slots negative where in outage. outages: how many links
    are. slots: spent on all links, lost messages included. longest: of each transmission, summed.
    """

    record: NDArray[np.int32]
    outages: int
    slots: int
    longest: int


def account(tick: int, links: Links, sent: Transmission, *, compiled: bool = True) -> Account:
    """`sent`: over these links; `compiled`: with the compiled kernel, if there is one; the numbers are the same."""
    if compiled and kernel.is_compiled():
        return Account(*kernel.account(links.record, tick, sent.slots, sent.missing, links.first))
    record = links.record.copy()
    record[:, 0], record[:, 4] = tick, np.where(sent.delivered, sent.slots, -sent.slots)
    longest = np.maximum.reduceat(sent.slots, links.first) if len(links.first) else links.first
    return Account(record, int((~sent.delivered).sum()), int(sent.slots.sum()), int(longest.sum()))
