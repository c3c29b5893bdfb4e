"""What motion costs a rotary-wing craft, Eq. Power1."""

import numpy as np

from swarm import state
from swarm.scenario import Vehicle


def power(vehicle: Vehicle, speed: state.Rows) -> state.Rows:
    """P(‖v‖) in watts, of speeds in m/s; same shape. Blade profile + induced + parasite power."""
    squared = speed * speed
    induced = squared / (2.0 * vehicle.induced_velocity**2)
    blade = vehicle.blade_power * (1.0 + 3.0 * squared / vehicle.tip_speed**2)
    # √(1+u²) − u = 1/(√(1+u²) + u): the printed form cancels to nothing at speed
    lift = vehicle.induced_power / np.sqrt(np.sqrt(1.0 + induced * induced) + induced)
    return blade + lift + vehicle.parasite_drag * squared * speed / 2.0
