"""A tick of motion: a point mass under command, drag and wind, and the UAVs that are at their goals."""

import numpy as np

from meanflock.kernels import state
from meanflock.kernels.state import Floats, Mask


def move(
    states: Floats,
    acceleration: Floats,
    noise: Floats,
    wind: Floats,
    drag: float,
    shake: float,
    dt: float,
    moved: Floats,
    /,
) -> None:
    """Write the states (N, 4) after a tick to `moved`: dv = (a − drag (v − wind)) dt + shake · noise, dr = v dt.

    Args:
        acceleration: (N, 2), m/s². noise: (N, 2), standard normal. wind: (N, 2) or (2,), m/s. drag: 1/s. shake: m/s.
            dt: s.
    """
    change = state.velocity(states) - wind
    change *= drag
    np.subtract(acceleration, change, out=change)
    change *= dt
    velocity = np.add(state.velocity(states), change, out=change)
    velocity += shake * noise
    state.velocity(moved)[...] = velocity
    velocity *= dt
    np.add(velocity, state.position(states), out=state.position(moved))


def reached(states: Floats, goals: Floats, radius: float, within: Mask, /) -> int:
    """Write which UAVs (N, 4) are at most `radius` from their goals (N, 4) to `within` (N,); returns how many of those
    that were set before, and clears the others.
    """
    within &= state.norm(states - goals) <= radius
    return int(np.count_nonzero(within))
