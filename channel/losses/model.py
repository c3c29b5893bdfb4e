"""Form of a path loss: the geometry it takes, the numbers it returns, and the range in which its source holds."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm.state import Floats

LIGHT_M_S = 299_792_458.0
EVERYWHERE_M = 1e9  # beyond all distances
NEAREST_M = 1.0  # shorter links count as this long: all formulas are of the far field
Range: TypeAlias = tuple[float, float]
ANY: Range = (0.0, math.inf)
Each: TypeAlias = Floats | np.float64  # a number of each link (K,), or one for all


class Geometry(NamedTuple):
    """Ends of K links, in m; heights are of each link or of all.

    ground_m: horizontal distance. base_m: height of the station, or of the lower of two UAVs. uav_m: height of the
    other end. slant_m: distance of the antennas, at least 1 m.
    """

    ground_m: Floats
    base_m: Each
    uav_m: Each
    slant_m: Floats


class Losses(NamedTuple):
    """Attenuation of K links.

    clear_db, blocked_db: mean loss with and without line of sight. sight: probability of a line of sight.
    clear_sigma_db, blocked_sigma_db: standard deviations of the shadow.
    """

    clear_db: Floats
    blocked_db: Floats
    sight: Each
    clear_sigma_db: Each
    blocked_sigma_db: Each


class Validity(NamedTuple):
    """Range of a source: horizontal distance and heights in m, carrier in GHz; both ends are included."""

    ground_m: Range = ANY
    base_m: Range = ANY
    uav_m: Range = ANY
    carrier_ghz: Range = ANY

    def clamped(self, ground_m: Floats, base_m: Each, uav_m: Each) -> tuple[Geometry, NDArray[np.bool_]]:
        """The geometry of K links, moved to the end of this range, and the mask (K,) of the links that moved."""
        outside = np.zeros(len(ground_m), dtype=bool)
        inside: list[Any] = [ground_m, base_m, uav_m]
        for column, limits in enumerate(self[:3]):
            given, (least, most) = inside[column], limits
            if limits != ANY and np.count_nonzero(beyond := (given < least) | (given > most)):
                inside[column] = np.clip(given, least, most)
                outside |= beyond
        return geometry(*inside), outside

    def fault(self, ground_m: Floats, base_m: Floats, uav_m: Floats, carrier_ghz: float) -> str | None:
        """The first number outside this range, as a text; None if all are inside. Arrays of any shape."""
        names = ("horizontal distance", "height of the station or lower UAV", "height of the UAV", "carrier")
        values = (ground_m, base_m, uav_m, np.array([carrier_ghz]))
        for name, value, (least, most), unit in zip(names, values, self, ("m", "m", "m", "GHz"), strict=True):
            for wrong in value[(value < least) | (value > most)][:1].tolist():
                return f"a {name} of {wrong:.6g} {unit} is outside {least:g} to {most:g} {unit}"
        return None


class Model(NamedTuple):
    """A path loss and what its source says of it.

    losses: function of a geometry and the carrier in GHz. has_sight: whether links with and without sight differ.
    correlation_m: distance at which the shadow's correlation is 1/e, with and without sight; None if the source has no
    shadow. sight_m: the same of the state of sight.
    """

    losses: Callable[[Geometry, float], Losses]
    validity: Validity = Validity()
    has_sight: bool = False
    correlation_m: tuple[float, float] | None = None
    sight_m: float = 50.0


def geometry(ground_m: Floats, base_m: Each, uav_m: Each) -> Geometry:
    """The geometry of K links; see `Geometry`."""
    rise_m = uav_m - base_m
    return Geometry(ground_m, base_m, uav_m, np.sqrt(np.maximum(ground_m * ground_m + rise_m * rise_m, NEAREST_M**2)))


def sight_within(ground_m: Floats, near_m: Each | float, decay_m: Each | float) -> Floats:
    """Probability of sight of 3GPP's tables: 1 up to d₁, then d₁/d + e^(−d/p) (1 − d₁/d); (K,).

    `near_m`: d₁, `EVERYWHERE_M` if all links are in sight. `decay_m`: p.
    """
    share = near_m / np.maximum(ground_m, near_m)
    return share + np.exp(ground_m / -decay_m) * (1.0 - share)


def two_states(
    clear_db: Floats, blocked_db: Floats, sight: Floats, clear_sigma_db: Each, blocked_sigma_db: Each
) -> Losses:
    """Losses with and without sight, of which the second is at least the first."""
    return Losses(clear_db, np.maximum(clear_db, blocked_db), sight, clear_sigma_db, blocked_sigma_db)


def one_state(loss_db: Floats) -> Losses:
    """Losses without states of sight and without shadow."""
    return Losses(loss_db, loss_db, np.float64(1.0), np.float64(0.0), np.float64(0.0))
