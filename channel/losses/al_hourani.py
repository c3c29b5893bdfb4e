"""Path loss between a terminal in the street and a UAV above a town.

Al-Hourani, Kandeepan, Lardner, Optimal LAP altitude for maximum coverage, IEEE Wireless Communications Letters 3(6),
569–572, 2014. Its sigmoid fits the line of sight of ITU-R P.1410 from about 10° of elevation.
"""

from typing import NamedTuple

import numpy as np

from meanflock.channel.losses.model import Geometry, Losses
from meanflock.channel.losses.plain import at_1m_db


class Environment(NamedTuple):
    """Constants of a town: those of the sigmoid (a, in degrees, and b, in 1/degree), and excess losses in dB."""

    a: float
    b: float
    eta_los_db: float
    eta_nlos_db: float


ENVIRONMENTS = {
    "suburban": Environment(4.88, 0.43, 0.1, 21.0),
    "urban": Environment(9.61, 0.16, 1.0, 20.0),
    "dense-urban": Environment(12.08, 0.11, 1.6, 23.0),
    "highrise": Environment(27.23, 0.08, 2.3, 34.0),
}


def al_hourani(links: Geometry, carrier_ghz: float, *, environment: Environment) -> Losses:
    """Free space plus η; a line of sight has the probability 1 / (1 + a e^(−b(θ − a))), θ the elevation in degrees."""
    a, b, clear_db, blocked_db = environment
    elevation = np.degrees(np.arctan2(links.uav_m - links.base_m, links.ground_m))
    free = at_1m_db(carrier_ghz) + 20.0 * np.log10(links.slant_m)
    sight = 1.0 / (1.0 + a * np.exp(-b * (elevation - a)))
    return Losses(free + clear_db, free + blocked_db, sight, np.float64(0.0), np.float64(0.0))
