"""The colours of a recording, as 0xRRGGBBAA, and the scales of those that stand for a number."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

PHI_G_LOW, PHI_G_HIGH = 1e-3, 1.0  # ends of the logarithmic colour scale of φ_G, 1/s²
SPEED_HIGH = 5.0  # end of the colour scale of speed, which begins at 0, m/s

# Told apart with every common colour vision: what is delivered from what is not, and the lines of one plot.
BLUE, ORANGE, GREEN, RED = 0x5AA9E6FF, 0xF4A259FF, 0x35D6A0FF, 0xF2552CFF
VIOLET, WHITE, GREY, PINK, ICE = 0x8B5CF6FF, 0xECEFF4FF, 0x8A93A6FF, 0xFF7AC6FF, 0x8FE9FFFF
COLLISION, HIT, HEAD = PINK, ORANGE, BLUE
LINES = (ORANGE, BLUE, GREEN, VIOLET, WHITE, GREY, RED, PINK, ICE)  # of one plot; who has more begins again
DISC, BREEZE = 0x3A4150FF, 0xF4A25966  # an obstacle; the wind at a place
FROZEN, CUT, JAMMED, GUST = ICE, RED, RED, ORANGE  # what stops the radio has the colour of its outages
# Viridis at even steps from an eighth of its length on, for what is darker is lost on the canvas.
_VIRIDIS = np.array(
    [
        (84, 62, 150),
        (64, 90, 150),
        (44, 114, 142),
        (33, 145, 140),
        (40, 174, 128),
        (94, 201, 98),
        (173, 220, 48),
        (253, 231, 37),
    ],
    dtype=np.float64,
)

_STEPS = np.linspace(0.0, 1.0, len(_VIRIDIS))
_CHANNELS = [
    (np.append(np.diff(base) / np.diff(_STEPS), 0.0), base) for base in _VIRIDIS.T.copy()
]  # slope from each step on


def viridis(share: NDArray[np.float64]) -> NDArray[np.uint32]:
    """RGBA colours, shape `(...)`, of numbers in [0, 1]; those outside take the colour of the nearer end."""
    share = np.clip(share, 0.0, 1.0, dtype=np.float64)
    step = (share * (len(_VIRIDIS) - 1)).astype(np.intp)  # they are even: nothing to search for
    share -= _STEPS[step]
    color = np.full(share.shape, 0xFF, dtype=np.uint32)
    for bits, (slope, base) in zip((24, 16, 8), _CHANNELS, strict=True):
        color |= (slope[step] * share + base[step]).astype(np.uint32) << bits
    return color


def phi_g_colors(phi_g: NDArray[np.float32]) -> NDArray[np.uint32]:
    """RGBA colours, shape `(...)`, of φ_G ≥ 0 on the logarithmic scale that the map's legend shows."""
    low, high = math.log10(PHI_G_LOW), math.log10(PHI_G_HIGH)
    return viridis((np.log10(np.maximum(phi_g, PHI_G_LOW)) - low) / (high - low))


def speed_colors(speed_m_s: NDArray[Any]) -> NDArray[np.uint32]:
    """RGBA colours, shape `(...)`, of speeds on the linear scale that the map's legend shows."""
    return viridis(speed_m_s / SPEED_HIGH)
