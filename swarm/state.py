"""The state of a UAV, as all rooms name it; `kernels/state.py` defines it, for what is compiled needs it first."""

from meanflock.kernels.state import (
    AXES,
    POSITION,
    SIZE,
    VELOCITY,
    VX,
    VY,
    Plane,
    Rows,
    States,
    X,
    Y,
    dot,
    norm,
    speed,
)

__all__ = [
    "AXES",
    "POSITION",
    "SIZE",
    "VELOCITY",
    "VX",
    "VY",
    "Plane",
    "Rows",
    "States",
    "X",
    "Y",
    "dot",
    "norm",
    "speed",
]
