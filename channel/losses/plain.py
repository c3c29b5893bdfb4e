"""Path losses without states of sight: free space, log-distance, and two rays over a mirror."""

import math

import numpy as np

from meanflock.channel.losses.model import LIGHT_M_S, Geometry, Losses, one_state


def at_1m_db(carrier_ghz: float) -> float:
    """Loss of free space at 1 m: 20 lg(4π f / c); Friis, Proc. IRE 34, 1946."""
    return 20.0 * math.log10(4.0e9 * math.pi * carrier_ghz / LIGHT_M_S)


def free_space(links: Geometry, carrier_ghz: float) -> Losses:
    """Free space."""
    return one_state(at_1m_db(carrier_ghz) + 20.0 * np.log10(links.slant_m))


def log_distance(links: Geometry, carrier_ghz: float, *, exponent: float, reference_db: float | None) -> Losses:
    """L₁ + 10 n lg d: Rappaport, Wireless Communications, §4.9. L₁ is the loss at 1 m: free space unless given."""
    begin_db = at_1m_db(carrier_ghz) if reference_db is None else reference_db
    return one_state(begin_db + 10.0 * exponent * np.log10(links.slant_m))


def two_ray(links: Geometry, carrier_ghz: float) -> Losses:
    """Sum of the direct ray and the ray reflected by smooth ground or water, with phase and Γ = −1: Rappaport §4.6."""
    wave_number = 2.0e9 * np.pi * carrier_ghz / LIGHT_M_S
    reflected_m = np.hypot(links.ground_m, links.uav_m + links.base_m)
    field = np.exp(-1j * wave_number * links.slant_m) / links.slant_m
    field -= np.exp(-1j * wave_number * reflected_m) / reflected_m
    return one_state(-20.0 * np.log10(np.abs(field) / (2.0 * wave_number)))
