"""Power of a rotary wing that climbs or sinks, by momentum theory (Glauert; Leishman, Principles of Helicopter
Aerodynamics, 2nd ed. 2006, ch. 2).

P = P₀ (1 + 3V_h²/U_tip²) + W (V_z + v_i) + ½ d₀ρsA V³, and v_i √(V_h² + (V_z + v_i)²) = v₀². At V_z = 0 the solution
is v_i = v₀ (√(1 + V⁴/4v₀⁴) − V²/2v₀²)^½, so P is Eq. Power1 with P_i = W v₀. W = λ1/χ_o follows from the printed
constants.

Momentum theory does not hold where the rotor sinks into its own wake. Without forward speed v_i is Leishman's fit to
measurements for −2v₀ < V_z < 0, and the windmill branch of the theory below. The theory holds again for V_h ≥ v₀.
Between, the ratio of v_i to its value at V_z = 0 is interpolated in V_h²/v₀², so power is continuous.
"""

import numpy as np

from meanflock.swarm.scenario import VehicleTable
from meanflock.swarm.state import Rows

_NEWTON_STEPS = 4  # error of v_i/v₀ below 1e-8 at any speed


def power(vehicle: VehicleTable, level: Rows, climb: Rows, speed: Rows) -> Rows:
    """Power at the speeds V_h = `level`, V_z = `climb` (upward) and V = `speed`, (R,) m/s each; never below P₀, W.

    The rotor is not credited with what a windmill could gain.
    """
    own = vehicle.induced_velocity
    mu_squared, x = level * level / (own * own), climb / own
    profile = vehicle.blade_power * (1.0 + 3.0 * (level * level) / vehicle.tip_speed**2)
    lift = vehicle.induced_power * (x + np.where(x < 0.0, _sinking(mu_squared, x), _climbing(mu_squared, x)))
    return np.maximum(profile + lift + vehicle.parasite_drag * speed * speed * speed / 2.0, vehicle.blade_power)


def _level(mu_squared: Rows) -> Rows:
    """v_i/v₀ at V_z = 0 for (V_h/v₀)²."""
    half = 0.5 * mu_squared
    return 1.0 / np.sqrt(np.sqrt(1.0 + half * half) + half)


def _climbing(mu_squared: Rows, x: Rows) -> Rows:
    """v_i/v₀ for x = V_z/v₀ ≥ 0. It starts from the lesser of the level and of the vertical solution, which are both
    above the root, so Newton's method converges from one side; a vertical climb starts at its root."""
    half = 0.5 * np.maximum(x, 0.0)
    vertical = 1.0 / (np.sqrt(1.0 + half * half) + half)
    return _root(mu_squared, 2.0 * half, np.minimum(_level(mu_squared), vertical))


def _sinking(mu_squared: Rows, x: Rows) -> Rows:
    """v_i/v₀ for x = V_z/v₀ < 0."""
    x = np.minimum(x, 0.0)
    forward = np.maximum(mu_squared, 1.0)  # here the equation has one root
    level = _level(forward)
    ahead = _root(forward, x, np.minimum(level, 1.0 / np.sqrt(forward + x * x))) / level
    share = np.minimum(mu_squared, 1.0)
    return _level(mu_squared) * ((1.0 - share) * _vertical_descent(x) + share * ahead)


def _vertical_descent(x: Rows) -> Rows:
    """v_i/v₀ of a vertical descent: Leishman's fit; below −2 the windmill branch, once it is above the fit."""
    fit = 1.0 + x * (-1.125 + x * (-1.372 + x * (-1.718 - 0.655 * x)))
    half = -0.5 * x
    windmill = 1.0 / (half + np.sqrt(np.maximum(half * half - 1.0, 0.0)) + (half == 0.0))
    return np.where(x > -2.0, fit, np.maximum(fit, windmill))


def _root(mu_squared: Rows, x: Rows, start: Rows) -> Rows:
    """The root λ of λ²(μ² + (x + λ)²) = 1 by Newton's method."""
    root = start
    for _ in range(_NEWTON_STEPS):
        through = x + root
        squared = mu_squared + through * through
        root = root - (root * root * squared - 1.0) / (2.0 * root * (squared + root * through))
    return root
