"""The state of a UAV, as all packages name it; `kernels/state.py` defines it, for what is compiled needs it first."""

from meanflock.kernels.state import (  # noqa: F401
    AXES,
    POSITION,
    SIZE,
    VELOCITY,
    VX,
    VY,
    Floats,
    Mask,
    Plane,
    Rows,
    States,
    X,
    Y,
    approach,
    dot,
    norm,
    speed,
)
