"""How many uploads are taken to be false."""

import math


def suspects(count: int, tolerance: float) -> int:
    """f of `count` uploads, ⌈tolerance·count⌉; never so many that none is left between them."""
    return min(math.ceil(tolerance * count - 1e-9), (count - 1) // 2)
