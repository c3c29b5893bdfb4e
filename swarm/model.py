"""The layout of a UAV's model on the radio: which floats travel, in which order.

A whole model is the vector [ŵ_H0 (54), ŵ_H1 (54), ŵ_F0 (69), ŵ_F1 (69)]; a method shares a contiguous part of it.
"""

from swarm.methods import Method

VALUE_FEATURES = 54  # M_H: terms of σ_H
DENSITY_FEATURES = 69  # M_F: terms of σ_F
VALUE = slice(0, 2 * VALUE_FEATURES)
DENSITY = slice(VALUE.stop, VALUE.stop + 2 * DENSITY_FEATURES)
MODEL_FLOATS = DENSITY.stop  # 246

BEYOND_SENSE = 1e30  # no weight, acceleration, residual or φ_G of a learner that still learns; NaN is not below it


def shared(method: Method) -> slice:
    """The part of the whole model that `method` uploads and broadcasts; empty for methods without rounds."""
    start = VALUE.start if method.shares_value else DENSITY.start
    stop = DENSITY.stop if method.shares_density else VALUE.stop
    return slice(start, stop) if method.is_federated else slice(0, 0)


def shared_floats(method: Method) -> int:
    """L(ŵ): 108 for H, 138 for F, 246 for HF, 0 without rounds."""
    part = shared(method)
    return int(part.stop - part.start)


def part_sizes(method: Method) -> tuple[int, ...]:
    """Weights of ŵ_H0, ŵ_H1, ŵ_F0, ŵ_F1, as far as `method` shares them."""
    value = (VALUE_FEATURES,) * 2 if method.shares_value else ()
    return value + ((DENSITY_FEATURES,) * 2 if method.shares_density else ())
