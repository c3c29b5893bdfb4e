"""Propagation over one kind of link: mean loss, state of sight, shadow, and the law of fading of each link."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meanflock.channel.fields import GaussianField, normal_with
from meanflock.channel.losses.model import Each, Model
from meanflock.swarm.state import Floats, Mask, squared

Indices = NDArray[np.intp]
CORRELATION_M = 37.0  # of a shadow whose source has none: UMa's with sight


class Propagation(NamedTuple):
    """Kind of link, between UAVs or from UAVs to stations.

    sigma_db, correlation_m: of the shadow; None: those of the path loss. shadow, sight: fields of places. clear,
    blocked: index of the law of fading with and without sight. is_ground: whether it leads to stations. by_elevation:
    `clear` is the law of 0°, and one for each degree follows.
    """

    model: Model
    sigma_db: float | None
    carrier_ghz: float
    correlation_m: float | None
    shadow: GaussianField
    sight: GaussianField
    clear: int
    blocked: int
    is_ground: bool
    by_elevation: bool = False

    def over(self, place_m: Floats, low: Indices, high: Indices) -> tuple[Floats, Indices | int, Mask]:
        """Propagation between P pairs of nodes.

        Args:
            place_m: (nodes, 3), m. low, high: (P,) the UAV and the station, or two UAVs.

        Returns:
            Loss with shadow in dB (P,); index of the law of fading (P,), or a single one; and the mask (P,) of pairs
            outside the validity of the path loss.
        """
        x, y, z = place_m[:, 0], place_m[:, 1], place_m[:, 2]
        ground_m = np.sqrt(squared((x.take(low) - x.take(high), y.take(low) - y.take(high))))
        geometry, outside = self.model.validity.clamped(ground_m, *self._heights(z, low, high))
        losses = self.model.losses(geometry, self.carrier_ghz)
        law: Any = self.clear
        if self.by_elevation:
            rise_m = np.abs(z.take(low) - z.take(high))
            law = law + np.rint(np.degrees(np.arctan2(rise_m, geometry.ground_m))).astype(np.intp)
        pairs = place_m, low, high, self.is_ground
        loss_db = losses.clear_db + self._shadow_db(losses.clear_sigma_db, 0, *pairs)
        if self.model.has_sight:
            blocked = self.sight.between(*pairs, self.model.sight_m) >= normal_with(np.asarray(losses.sight))
            if np.count_nonzero(blocked):
                blocked_db = losses.blocked_db + self._shadow_db(losses.blocked_sigma_db, 1, *pairs)
                loss_db, law = np.where(blocked, blocked_db, loss_db), np.where(blocked, self.blocked, law)
        return loss_db, law, outside

    def _heights(self, z: Floats, low: Indices, high: Indices) -> tuple[Each, Each]:
        """Heights of the station or lower UAV, and of the UAV above, of pairs; a single number if all are the same."""
        if not np.count_nonzero(z != z[0]):
            return z[0], z[0]
        one, other = z.take(low), z.take(high)
        return (other, one) if self.is_ground else (np.minimum(one, other), np.maximum(one, other))

    def sigma(self, tabulated_db: Each) -> Each:
        """Standard deviations of the shadow, each or a single one, dB."""
        return tabulated_db if self.sigma_db is None else np.float64(self.sigma_db)

    def _shadow_db(
        self, tabulated_db: Each, state: int, place_m: Floats, low: Indices, high: Indices, is_ground: bool
    ) -> Each:
        """The shadow of pairs in sight (`state` 0) or without (1), (P,), or 0 if there is none, dB."""
        sigma_db = self.sigma(tabulated_db)
        if not np.count_nonzero(sigma_db):
            return np.float64(0.0)
        tabulated_m = (self.model.correlation_m or (CORRELATION_M, CORRELATION_M))[state]
        return sigma_db * self.shadow.between(place_m, low, high, is_ground, self.correlation_m or tabulated_m)
