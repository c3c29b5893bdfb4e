"""How long a link may be silent before its other end is taken for gone."""

import math
import os

from meanflock.swarm.errors import BadInput

LEASE = "MEANFLOCK_LEASE"  # a variable: seconds in which the other side must hear of this process
_LEASE_S = (1.0, 10.0, 600.0)  # the least, where it is not set, the most


def lease() -> dict[str, int]:
    """How long a link may be silent, and how long a message may wait for one. Two may wait for the same, one after the
    other, and nothing is received meanwhile: three tenths each leave the other links time for a sign of life.

    Raises:
        BadInput: the variable is no such number.
    """
    least, default, most = _LEASE_S
    said = os.environ.get(LEASE) or str(default)
    try:
        lease_s = float(said)
    except ValueError:
        lease_s = math.nan
    if not least <= lease_s <= most:
        raise BadInput(f"{LEASE}={said}: seconds from {least:g} to {most:g}; {default:g} where it is not set")
    return {
        "transport/link/tx/lease": int(1e3 * lease_s),
        "transport/link/tx/queue/congestion_control/block/wait_before_close": int(3e5 * lease_s),  # µs
    }
