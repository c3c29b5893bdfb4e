"""Path losses without states of sight: free space, log-distance, and two rays over a mirror."""

import numpy as np

from meanflock.channel.losses.model import LIGHT_M_S, Geometry, Losses, one_state
from meanflock.swarm.state import Floats


def free_space_db(slant_m: Floats, carrier_ghz: float) -> Floats:
    """20 lg(4π d f / c), (K,): Friis, Proc. IRE 34, 1946."""
    loss: Floats = 20.0 * np.log10(4.0e9 * np.pi * carrier_ghz / LIGHT_M_S * slant_m)
    return loss


def free_space(links: Geometry, carrier_ghz: float) -> Losses:
    """Free space."""
    return one_state(free_space_db(links.slant_m, carrier_ghz))


def log_distance(links: Geometry, carrier_ghz: float, *, exponent: float, reference_db: float | None) -> Losses:
    """L₁ + 10 n lg d: Rappaport, Wireless Communications, §4.9. L₁ is the loss at 1 m: free space unless given."""
    at_1m_db = free_space_db(np.ones(1), carrier_ghz) if reference_db is None else reference_db
    return one_state(at_1m_db + 10.0 * exponent * np.log10(links.slant_m))


def two_ray(links: Geometry, carrier_ghz: float) -> Losses:
    """Sum of the direct ray and the ray reflected by smooth ground or water, with phase and Γ = −1: Rappaport §4.6."""
    wave_number = 2.0e9 * np.pi * carrier_ghz / LIGHT_M_S
    reflected_m = np.hypot(links.ground_m, links.uav_m + links.base_m)
    field = np.exp(-1j * wave_number * links.slant_m) / links.slant_m
    field -= np.exp(-1j * wave_number * reflected_m) / reflected_m
    return one_state(-20.0 * np.log10(np.abs(field) / (2.0 * wave_number)))
