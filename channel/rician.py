"""Rice fading: the amplitude of a line of sight plus scattered paths, Eq. Rice.

The printed density writes I₀(zξ/χ²) for I₀(ζξ/χ²), and Rayleigh as ζ = 0 for ξ = 0; both are read as slips.
"""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def squared_amplitude(draw: np.random.Generator, count: int, xi: float, chi: float) -> Floats:
    """z² of `count` independent slots, `(count,)`; z = |ξ + χ(n₁ + jn₂)| with standard normal n₁, n₂."""
    paths = draw.standard_normal((count, 2))  # in phase, in quadrature; in place, for they come by the thousand
    paths *= chi
    paths[:, 0] += xi
    paths *= paths
    return paths[:, 0] + paths[:, 1]
