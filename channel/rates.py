"""Rates of a slot: the bits that it carries for each second and hertz, and the SNR that it needs."""

import math
from typing import NamedTuple


class Rate(NamedTuple):
    """Spectral efficiency in bit/s/Hz, and the SNR in dB from which a slot carries it."""

    efficiency: float
    threshold_db: float


# TS 38.214 Table 5.2.2.1-2: efficiency of CQI 1 to 15. Thresholds at 10 % block errors: Vienna LTE simulator.
CQI = tuple(
    Rate(*row)
    for row in (
        (0.1523, -6.936),
        (0.2344, -5.147),
        (0.3770, -3.180),
        (0.6016, -1.253),
        (0.8770, 0.761),
        (1.1758, 2.699),
        (1.4766, 4.694),
        (1.9141, 6.525),
        (2.4063, 8.573),
        (2.7305, 10.366),
        (3.3223, 12.289),
        (3.9023, 14.173),
        (4.5234, 15.888),
        (5.1152, 17.814),
        (5.5547, 19.829),
    )
)


def cqi(index: int) -> Rate:
    """The rate of a channel quality indicator, 1 to 15."""
    return CQI[index - 1]


def shannon(threshold_db: float, gap_db: float) -> Rate:
    """log₂(1 + η/Γ) at the SNR η, for a code that needs Γ times the SNR of Shannon's limit."""
    return Rate(math.log2(1.0 + 10.0 ** ((threshold_db - gap_db) / 10.0)), threshold_db)
