"""Rice fading: the amplitude of a line of sight plus scattered paths, Eq. Rice.

The printed density writes I₀(zξ/χ²) for I₀(ζξ/χ²), and Rayleigh as ζ = 0 for ξ = 0; both are read as slips.
"""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def squared_amplitude(normal: Floats, xi: float, chi: float) -> Floats:
    """z² of independent slots, `(count,)`; z = |ξ + χ(n₁ + jn₂)|, `normal`: standard normal n₁, n₂, `(count, 2)`."""
    paths = normal * chi  # in phase, in quadrature; in place from here, for they come by the thousand
    paths[:, 0] += xi
    paths *= paths
    return paths[:, 0] + paths[:, 1]
