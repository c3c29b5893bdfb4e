"""Path losses of 3GPP between a base station and a terminal near the ground: TR 38.901 v19.4.

Losses and σ are of Table 7.4.1-1, probabilities of sight of Table 7.4.2-1. The building is 5 m high, the street 20 m
wide, and the effective height of the environment is 1 m.
"""

import numpy as np

from meanflock.channel.losses.model import Geometry, Losses, sight_within, two_states
from meanflock.swarm.state import Floats

_LIGHT = 3.0e8  # m/s, as the tables have it
BUILDING_M, STREET_M = 5.0, 20.0
NEAR_M = 18.0  # up to which a terminal is in sight


def uma(links: Geometry, carrier_ghz: float) -> Losses:
    """Urban macro cell: the station stands on a roof, at 25 m."""
    slant, frequency = np.log10(links.slant_m), 20.0 * np.log10(carrier_ghz)
    clear = _broken(links, carrier_ghz, 28.0 + 22.0 * slant, 28.0 + 40.0 * slant, 9.0) + frequency
    blocked = 13.54 + 39.08 * slant + frequency - 0.6 * (links.uav_m - 1.5)
    near = sight_within(links.ground_m, NEAR_M, 63.0)
    above = (np.maximum(links.uav_m - 13.0, 0.0) / 10.0) ** 1.5
    far = 1.25 * (links.ground_m / 100.0) ** 3 * np.exp(-links.ground_m / 150.0)
    sight = np.where(links.ground_m > NEAR_M, near * (1.0 + above * far), 1.0)
    return two_states(clear, blocked, np.minimum(sight, 1.0), np.float64(4.0), np.float64(6.0))


def umi(links: Geometry, carrier_ghz: float) -> Losses:
    """Urban micro cell: the station stands in a street canyon, at 10 m."""
    slant, frequency = np.log10(links.slant_m), np.log10(carrier_ghz)
    clear = _broken(links, carrier_ghz, 32.4 + 21.0 * slant, 32.4 + 40.0 * slant, 9.5) + 20.0 * frequency
    blocked = 22.4 + 35.3 * slant + 21.3 * frequency - 0.3 * (links.uav_m - 1.5)
    return two_states(clear, blocked, sight_within(links.ground_m, NEAR_M, 36.0), np.float64(4.0), np.float64(7.82))


def rma(links: Geometry, carrier_ghz: float, building_m: float = BUILDING_M) -> Losses:
    """Rural macro cell: the station stands at 10 to 150 m."""
    break_m = 2.0e9 * np.pi * links.base_m * links.uav_m * carrier_ghz / _LIGHT
    is_far = links.ground_m > break_m
    before_m = np.where(is_far, break_m, links.slant_m)
    power, frequency = building_m**1.72, 20.0 * np.log10(carrier_ghz)
    clear = 20.0 * np.log10(40.0 * np.pi * carrier_ghz / 3.0 * before_m)
    clear += min(0.03 * power, 10.0) * np.log10(before_m) - min(0.044 * power, 14.77)
    clear += 0.002 * np.log10(building_m) * before_m + 40.0 * np.log10(links.slant_m / before_m)
    base = np.log10(links.base_m)
    blocked = 161.04 - 7.1 * np.log10(STREET_M) + 7.5 * np.log10(building_m) + frequency
    blocked -= (24.37 - 3.7 * (building_m / links.base_m) ** 2) * base
    blocked += (43.42 - 3.1 * base) * (np.log10(links.slant_m) - 3.0)
    blocked -= 3.2 * np.log10(11.75 * links.uav_m) ** 2 - 4.97
    sight = np.exp(-np.maximum(links.ground_m - 10.0, 0.0) / 1000.0)
    return two_states(clear, blocked, sight, np.where(is_far, 6.0, 4.0), np.float64(8.0))


def _broken(links: Geometry, carrier_ghz: float, near_db: Floats, far_db: Floats, slope: float) -> Floats:
    """The loss before and after the breakpoint 4 (h₁ − 1)(h₂ − 1) f/c, (K,)."""
    break_m = 4.0e9 * (links.base_m - 1.0) * (links.uav_m - 1.0) * carrier_ghz / _LIGHT
    apart = break_m**2 + (links.base_m - links.uav_m) ** 2
    return np.where(links.ground_m <= break_m, near_db, far_db - slope * np.log10(np.maximum(apart, 1.0)))
