"""Path losses of 3GPP to UAVs: TR 36.777 v15.0, Tables B-1, B-2 and B-3, and between UAVs: TR 38.901 v19.4 §7.9.3.

At heights below those of TR 36.777 its tables refer to TR 38.901, as `terrestrial` has it.
"""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from meanflock.channel.losses import terrestrial
from meanflock.channel.losses.model import EVERYWHERE_M, Geometry, Losses, sight_within, two_states
from meanflock.channel.losses.plain import at_1m_db
from meanflock.swarm.state import Floats

RURAL_M, URBAN_M = 10.0, 22.5  # heights above which TR 36.777 has formulas of its own
VISIBLE_M = 100.0  # height above which UAVs are in sight of a macro cell and of each other


def uma_av(links: Geometry, carrier_ghz: float) -> Losses:
    """Urban macro cell to a UAV.

    The loss without sight is at least the loss with sight; the printed formula falls below it within 20 m.
    """
    return _either(links.uav_m > URBAN_M, _uma_av, terrestrial.uma, links, carrier_ghz)


def umi_av(links: Geometry, carrier_ghz: float) -> Losses:
    """Urban micro cell to a UAV."""
    return _either(links.uav_m > URBAN_M, _umi_av, terrestrial.umi, links, carrier_ghz)


def rma_av(links: Geometry, carrier_ghz: float) -> Losses:
    """Rural macro cell to a UAV."""
    return _either(links.uav_m > RURAL_M, _rma_av, terrestrial.rma, links, carrier_ghz)


def air_to_air(links: Geometry, carrier_ghz: float) -> Losses:
    """Two UAVs, case 9 of Table 7.9.3-1: loss of UMi-AV with the station at the lower UAV's height.

    The probability of sight is that of UMa-AV, and of UMi-AV if the lower UAV is at 22.5 m or below; it is 1 if a UAV
    is above 100 m.
    """
    return _either(links.base_m > URBAN_M, _both_high, _one_low, links, carrier_ghz)


def _either(
    is_one: NDArray[np.bool_] | np.bool_,
    one: Callable[[Geometry, float], Losses],
    other: Callable[[Geometry, float], Losses],
    links: Geometry,
    carrier_ghz: float,
) -> Losses:
    """Losses by one table, and by the other where `is_one` is false."""
    if np.count_nonzero(is_one) == np.size(is_one):
        return one(links, carrier_ghz)
    pairs = zip(one(links, carrier_ghz), other(links, carrier_ghz), strict=True)
    return Losses(*(np.where(is_one, *pair) for pair in pairs))


def _both_high(links: Geometry, carrier_ghz: float) -> Losses:
    return _umi_av(links, carrier_ghz, _uma_sight)


def _one_low(links: Geometry, carrier_ghz: float) -> Losses:
    found = umi_av(links, carrier_ghz)
    return found._replace(sight=np.where(links.uav_m > VISIBLE_M, 1.0, found.sight))


def _uma_av(links: Geometry, carrier_ghz: float) -> Losses:
    slant, height = np.log10(links.slant_m), np.log10(links.uav_m)
    clear = 28.0 + 20.0 * math.log10(carrier_ghz) + 22.0 * slant
    blocked = -17.5 + _at_1m_db(carrier_ghz) + (46.0 - 7.0 * height) * slant
    return two_states(clear, blocked, _uma_sight(links), 4.64 * np.exp(-0.0066 * links.uav_m), np.float64(6.0))


def _uma_sight(links: Geometry) -> Floats:
    height = np.log10(links.uav_m)
    near_m = np.where(links.uav_m > VISIBLE_M, EVERYWHERE_M, np.maximum(460.0 * height - 700.0, 18.0))
    return sight_within(links.ground_m, near_m, np.maximum(4300.0 * height - 3800.0, 1.0))


def _umi_sight(links: Geometry) -> Floats:
    height = np.log10(links.uav_m)
    near_m, decay_m = np.maximum(294.05 * height - 432.94, 18.0), np.maximum(233.98 * height - 0.95, 1.0)
    return sight_within(links.ground_m, near_m, decay_m)


def _umi_av(links: Geometry, carrier_ghz: float, sight: Callable[[Geometry], Floats] = _umi_sight) -> Losses:
    slant, height, frequency = np.log10(links.slant_m), np.log10(links.uav_m), 20.0 * math.log10(carrier_ghz)
    clear = (30.9 + frequency) + (22.25 - 0.5 * height) * slant
    clear = np.maximum(clear, at_1m_db(carrier_ghz) + 20.0 * slant)
    blocked = (32.4 + frequency) + (43.2 - 7.6 * height) * slant
    sigma_db = np.maximum(5.0 * np.exp(-0.01 * links.uav_m), 2.0)
    return two_states(clear, blocked, sight(links), sigma_db, np.float64(8.0))


def _rma_av(links: Geometry, carrier_ghz: float) -> Losses:
    slant, height = np.log10(links.slant_m), np.log10(links.uav_m)
    clear = np.maximum(23.9 - 1.8 * height, 20.0) * slant + _at_1m_db(carrier_ghz)
    blocked = (_at_1m_db(carrier_ghz) - 12.0) + (35.0 - 5.3 * height) * slant
    near_m = np.where(links.uav_m > 40.0, EVERYWHERE_M, np.maximum(1350.8 * height - 1602.0, 18.0))
    sight = sight_within(links.ground_m, near_m, np.maximum(15021.0 * height - 16053.0, 1000.0))
    return two_states(clear, blocked, sight, 4.2 * np.exp(-0.0046 * links.uav_m), np.float64(6.0))


def _at_1m_db(carrier_ghz: float) -> float:
    return 20.0 * math.log10(40.0 * math.pi * carrier_ghz / 3.0)
