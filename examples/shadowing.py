"""Log-normal shadowing that changes along the way: what attenuates a link now mostly still does a few metres on.

The shadow of a pair, in dB, is normal with deviation σ. While both ends move a way d together, it keeps the correlation
exp(−d / d_c) (Gudmundson, Correlation model for shadow fading in mobile radio systems, Electronics Letters 27, 1991).
It is the same in both directions.

    meanflock run --plugin examples/shadowing.py --set radio.model=shadowing --method vasarhelyi
"""

from statistics import NormalDist
from typing import Annotated

import numpy as np
from msgspec import Meta

import meanflock as mf
from meanflock.channel.link import slots_needed


class Shadowing(mf.Channel):
    """Path loss with an exponent, and a shadow of each pair of UAVs."""

    name = "shadowing"

    class Options(mf.Options, frozen=True):
        """Keys of the table [radio.options] of a scenario."""

        reach_m: Annotated[float, Meta(gt=0, description="distance at which half of the messages arrive, m")] = 50.0
        exponent: Annotated[float, Meta(ge=0, description="path loss exponent, 1")] = 3.0
        sigma_db: Annotated[float, Meta(gt=0, description="σ, standard deviation of the shadow, dB")] = 6.0
        correlation_m: Annotated[float, Meta(gt=0, description="d_c, way after which 1/e is left, m")] = 20.0

    def init(self, uavs):
        """For each pair its shadow, and where its ends were then: at first so far away that nothing is left of it."""
        return {"shadow_db": np.zeros((uavs, uavs)), "ends_m": np.full((uavs, uavs, 4), 1e12)}

    def carry(self, memory, message, rng):
        """Changes the shadows of the pairs that talk; a message arrives if its link has any margin left."""
        shadow_db, ends_m = memory["shadow_db"].copy(), memory["ends_m"].copy()
        uavs = len(shadow_db)
        low, high = np.minimum(message.source, message.target), np.maximum(message.source, message.target)
        pair, link = np.unique(low * uavs + high, return_inverse=True)
        low, high = np.divmod(pair, uavs)
        ends = np.concatenate([message.position_m[low], message.position_m[high]], axis=1)
        moved = (ends - ends_m[low, high]) ** 2
        way_m = np.sqrt(moved[:, 0] + moved[:, 1]) + np.sqrt(moved[:, 2] + moved[:, 3])
        correlation = np.exp(-way_m / self.options.correlation_m)
        fresh_db = self.options.sigma_db * rng.standard_normal(len(pair))
        shadow_db[low, high] = correlation * shadow_db[low, high] + np.sqrt(1.0 - correlation**2) * fresh_db
        ends_m[low, high] = ends
        slots = np.full(len(link), self.least_slots(message.bits))
        arrives = self._margin_db(message.distance_m) + shadow_db[low, high][link] > 0.0
        return {"shadow_db": shadow_db, "ends_m": ends_m}, slots, arrives

    def expected(self, distance_m, bits):
        """A single message knows nothing of the past: the closed form of shadows drawn afresh."""
        share = np.vectorize(NormalDist(0.0, self.options.sigma_db).cdf, otypes=[float])
        delivered = share(self._margin_db(distance_m))
        return float((1.0 - delivered).sum()), float(delivered.sum() * self.least_slots(bits))

    def least_slots(self, bits):
        """Least number of slots of a message."""
        return slots_needed(self.scenario.radio, bits)

    def _margin_db(self, distance_m):
        return 10.0 * self.options.exponent * np.log10(self.options.reach_m / np.maximum(distance_m, 1.0))
