"""Propagation over one kind of link: mean loss, state of sight, shadow, and the law of fading of each link."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meanflock.channel.fields import GaussianField, normal_with
from meanflock.channel.losses.model import Model
from meanflock.swarm.state import Floats

Indices = NDArray[np.intp]
CORRELATION_M = 37.0  # of a shadow whose source has none: UMa's with sight


class Propagation(NamedTuple):
    """Kind of link, between UAVs or from UAVs to stations.

    sigma_db, correlation_m: of the shadow; None: those of the path loss. shadow, sight: fields of places. clear,
    blocked: index of the law of fading with and without sight. by_elevation: `clear` is the law of 0°, and one for
    each degree follows.
    """

    model: Model
    carrier_ghz: float
    sigma_db: float | None
    correlation_m: float | None
    shadow: GaussianField
    sight: GaussianField
    clear: int
    blocked: int
    by_elevation: bool = False

    def over(self, place_m: Floats, low: Indices, high: Indices, is_ground: bool) -> tuple[Floats, Indices, int]:
        """Loss with shadow in dB (K,), index of each link's law (K,), and the number of links outside the validity.

        Args:
            place_m: (nodes, 3), m. low, high: (K,) the UAV and the station, or two UAVs. is_ground: which of these.
        """
        apart = place_m[low, :2] - place_m[high, :2]
        one, other = place_m[low, 2], place_m[high, 2]
        base_m, uav_m = (other, one) if is_ground else (np.minimum(one, other), np.maximum(one, other))
        geometry, outside = self.model.validity.clamped(np.hypot(apart[:, 0], apart[:, 1]), base_m, uav_m)
        losses = self.model.losses(geometry, self.carrier_ghz)
        law = np.full(len(low), self.clear)
        if self.by_elevation:
            law += np.rint(np.degrees(np.arctan2(np.abs(uav_m - base_m), geometry.ground_m))).astype(np.intp)
        links = place_m, low, high, is_ground
        if self.model.has_sight:
            in_sight = self.sight.between(*links, self.model.sight_m) < normal_with(losses.sight)
        if not self.model.has_sight or in_sight.all():
            loss_db = losses.clear_db + self._shadow_db(losses.clear_sigma_db, 0, *links)
        else:
            law[~in_sight] = self.blocked
            clear_db = losses.clear_db + self._shadow_db(losses.clear_sigma_db, 0, *links)
            blocked_db = losses.blocked_db + self._shadow_db(losses.blocked_sigma_db, 1, *links)
            loss_db = np.where(in_sight, clear_db, blocked_db)
        return loss_db, law, int(outside.sum())

    def sigma(self, tabulated_db: Floats) -> Floats:
        """Standard deviations of the shadow, (K,), dB."""
        return tabulated_db if self.sigma_db is None else np.full_like(tabulated_db, self.sigma_db)

    def _shadow_db(
        self, tabulated_db: Floats, state: int, place_m: Floats, low: Indices, high: Indices, is_ground: bool
    ) -> Floats:
        """The shadow of links in sight (`state` 0) or without (1), (K,), dB."""
        sigma_db = self.sigma(tabulated_db)
        if not sigma_db.any():
            return sigma_db
        tabulated_m = (self.model.correlation_m or (CORRELATION_M, CORRELATION_M))[state]
        return sigma_db * self.shadow.between(place_m, low, high, is_ground, self.correlation_m or tabulated_m)
