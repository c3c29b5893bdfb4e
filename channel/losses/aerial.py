"""Path losses of 3GPP to UAVs: TR 36.777 v15.0, Tables B-1, B-2 and B-3, and between UAVs: TR 38.901 v19.4 §7.9.3.

At heights below those of TR 36.777 its tables refer to TR 38.901, as `terrestrial` has it.
"""

from collections.abc import Callable

import numpy as np

from meanflock.channel.losses import terrestrial
from meanflock.channel.losses.model import Geometry, Losses, sight_within, two_states
from meanflock.channel.losses.plain import free_space_db
from meanflock.swarm.state import Floats

RURAL_M, URBAN_M = 10.0, 22.5  # heights above which TR 36.777 has formulas of its own


def uma_av(links: Geometry, carrier_ghz: float) -> Losses:
    """Urban macro cell to a UAV.

    The loss without sight is at least the loss with sight; the printed formula falls below it within 20 m.
    """
    return _above(URBAN_M, _uma_av, terrestrial.uma, links, carrier_ghz)


def umi_av(links: Geometry, carrier_ghz: float) -> Losses:
    """Urban micro cell to a UAV."""
    return _above(URBAN_M, _umi_av, terrestrial.umi, links, carrier_ghz)


def rma_av(links: Geometry, carrier_ghz: float) -> Losses:
    """Rural macro cell to a UAV."""
    return _above(RURAL_M, _rma_av, terrestrial.rma, links, carrier_ghz)


def air_to_air(links: Geometry, carrier_ghz: float) -> Losses:
    """Two UAVs, case 9 of Table 7.9.3-1: loss of UMi-AV with the station at the lower UAV's height.

    The probability of sight is that of UMa-AV, and of UMi-AV if the lower UAV is at 22.5 m or below; it is 1 if a UAV
    is above 100 m.
    """
    found = umi_av(links, carrier_ghz)
    sight = np.where(links.base_m > URBAN_M, _uma_sight(links.ground_m, links.uav_m), found.sight)
    return found._replace(sight=np.where(links.uav_m > 100.0, 1.0, sight))


def _above(
    limit_m: float,
    aerial: Callable[[Geometry, float], Losses],
    low: Callable[[Geometry, float], Losses],
    links: Geometry,
    carrier_ghz: float,
) -> Losses:
    """Losses by the table of UAVs above the limit, and by the other table up to it."""
    is_high = links.uav_m > limit_m
    if is_high.all():
        return aerial(links, carrier_ghz)
    pairs = zip(aerial(links, carrier_ghz), low(links, carrier_ghz), strict=True)
    return Losses(*(np.where(is_high, above, below) for above, below in pairs))


def _uma_av(links: Geometry, carrier_ghz: float) -> Losses:
    slant, height = np.log10(links.slant_m), np.log10(links.uav_m)
    clear = 28.0 + 22.0 * slant + 20.0 * np.log10(carrier_ghz)
    blocked = -17.5 + (46.0 - 7.0 * height) * slant + _at_1m_db(carrier_ghz)
    sight = _uma_sight(links.ground_m, links.uav_m)
    return two_states(clear, blocked, sight, 4.64 * np.exp(-0.0066 * links.uav_m), 6.0)


def _uma_sight(ground_m: Floats, height_m: Floats) -> Floats:
    height = np.log10(height_m)
    sight = sight_within(ground_m, np.maximum(460.0 * height - 700.0, 18.0), np.maximum(4300.0 * height - 3800.0, 1.0))
    return np.where(height_m > 100.0, 1.0, sight)


def _umi_av(links: Geometry, carrier_ghz: float) -> Losses:
    slant, height, frequency = np.log10(links.slant_m), np.log10(links.uav_m), 20.0 * np.log10(carrier_ghz)
    clear = 30.9 + (22.25 - 0.5 * height) * slant + frequency
    clear = np.maximum(clear, free_space_db(links.slant_m, carrier_ghz))
    blocked = 32.4 + (43.2 - 7.6 * height) * slant + frequency
    sight = sight_within(
        links.ground_m, np.maximum(294.05 * height - 432.94, 18.0), np.maximum(233.98 * height - 0.95, 1.0)
    )
    return two_states(clear, blocked, sight, np.maximum(5.0 * np.exp(-0.01 * links.uav_m), 2.0), 8.0)


def _rma_av(links: Geometry, carrier_ghz: float) -> Losses:
    slant, height = np.log10(links.slant_m), np.log10(links.uav_m)
    clear = np.maximum(23.9 - 1.8 * height, 20.0) * slant + _at_1m_db(carrier_ghz)
    blocked = -12.0 + (35.0 - 5.3 * height) * slant + _at_1m_db(carrier_ghz)
    near_m = np.maximum(1350.8 * height - 1602.0, 18.0)
    sight = sight_within(links.ground_m, near_m, np.maximum(15021.0 * height - 16053.0, 1000.0))
    sight = np.where(links.uav_m > 40.0, 1.0, sight)
    return two_states(clear, blocked, sight, 4.2 * np.exp(-0.0046 * links.uav_m), 6.0)


def _at_1m_db(carrier_ghz: float) -> float:
    return float(20.0 * np.log10(40.0 * np.pi * carrier_ghz / 3.0))
