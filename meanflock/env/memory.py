"""Memory that the flights of an environment need."""

from bisect import bisect

from meanflock.launch.memory import PAIR_BYTES, SMALL_MB, available_mb, in_words, needed_mb
from meanflock.swarm.errors import BadInput

# Measured values plus a quarter, of each pair of UAVs.
_WAITING_BYTES = 50  # of a flight while another one flies its tick: the states known to each UAV
_MESSAGE_BYTES = 45  # more for each number of a message, in the flight that flies its tick
_WAITING_MESSAGE_BYTES = 10  # in the others


def check(uavs: int, flights: int, message: int) -> None:
    """Check that some flights at once fit into memory, of which one at a time flies a tick.

    Args:
        uavs: of each flight. message: W, numbers of a message.

    Raises:
        BadInput: they do not fit; the text has the memory that they need.
    """
    of_pair = PAIR_BYTES + _MESSAGE_BYTES * message
    of_pair += (flights - 1) * (_WAITING_BYTES + _WAITING_MESSAGE_BYTES * message)
    needed, (available, limit) = needed_mb(uavs, 0, of_pair), available_mb()
    if needed <= max(available, SMALL_MB):
        return
    needs, left = in_words(needed, available)
    most = bisect(range(1, uavs), available, key=lambda n: needed_mb(n, 0, of_pair))
    what = f"{uavs} UAVs" if flights == 1 else f"{flights} flights of {uavs} UAVs each"
    remedies = [f"take uavs={most} at most"] * (most > 0) + ["take fewer flights"] * (flights > 1)
    raise BadInput(
        f"memory: {needs} for an environment of {what}, {left} {limit}; each UAV stores what it knows of all others, "
        f"so memory grows with N²: {', or '.join(remedies or ['free memory'])}"
    )
