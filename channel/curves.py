"""Curves of loss and latency over the margin of a link, as tables: a closed form costs an interpolation.

The margin is the mean SNR over the SNR that a slot needs, in dB.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from meanflock import kernels
from meanflock.channel import link, tails
from meanflock.channel.gains import Gain
from meanflock.channel.losses.model import Each
from meanflock.swarm.state import Floats

LOWEST_DB, HIGHEST_DB, PER_DB = -40, 60, 20  # margins beyond are taken as the nearest of these
MARGINS_DB = np.arange(LOWEST_DB * PER_DB, HIGHEST_DB * PER_DB + 1) / PER_DB
# Of a shadow: an even grid is exact to 4e-9, where Gauss–Hermite's nodes miss a sharp curve by 2 %.
NODES = np.linspace(-6.0, 6.0, 241)
WEIGHTS = np.exp(-0.5 * NODES**2) / np.exp(-0.5 * NODES**2).sum()


class Curves:
    """Success, loss and slots of messages over links with some laws of fading, which send in `most` slots at most."""

    def __init__(self, laws: Sequence[Gain], most: int) -> None:
        self._laws, self._most = tuple(laws), most
        self._is_step = np.array([law.is_steady for law in laws])
        self._has_steps = bool(self._is_step.any())
        self._success: Floats | None = None  # (laws · margins,)
        self._found: dict[int, Floats] = {}  # by needed slots
        self._averaged: dict[tuple[int, int, float], Floats] = {}

    def at(self, needed: int, law: NDArray[np.intp], margin_db: Floats) -> tuple[Floats, Floats]:
        """Probability of loss, and E[slots; delivered], of links with given margins; each (K,).

        Args:
            needed: good slots that the message takes. law: (K,) index of each link's law.
        """
        return self.chances(needed, law, margin_db)[1:]

    def chances(self, needed: int, law: NDArray[np.intp], margin_db: Floats) -> tuple[Floats, Floats, Floats]:
        """Probability that a slot is good, and then what `at` returns; each (K,)."""
        place = (margin_db - LOWEST_DB) * PER_DB
        if self._has_steps:  # which have no middle
            np.floor(place, out=place, where=self._is_step.take(law))
        found = np.empty((3, len(place)))
        kernels.interpolate(self._of(needed), law, place, found)
        success, lost, slots = found
        return success, lost, slots

    def shadowed(self, needed: int, law: int, margin_db: Floats, sigma_db: Each) -> tuple[Floats, Floats]:
        """The same on average over a shadow that is held for the whole message, with deviations in dB."""
        sigma_db = np.broadcast_to(sigma_db, margin_db.shape)
        lost, slots = np.empty(len(margin_db)), np.empty(len(margin_db))
        for sigma in np.unique(sigma_db).tolist():
            links = sigma_db == sigma
            if sigma == 0.0:
                lost[links], slots[links] = self._alike(needed, law, margin_db[links])
                continue
            if self._laws[law].is_steady:  # P[margin + shadow ≥ 0], where the even grid would have steps
                share = tails.normal_below(margin_db[links] / sigma) if needed <= self._most else 0.0
                lost[links], slots[links] = 1.0 - share, needed * share
                continue
            key = (needed, law, sigma)
            if key not in self._averaged:
                shaded = self._alike(needed, law, np.add.outer(MARGINS_DB, sigma * NODES).ravel())
                self._averaged[key] = (np.reshape(shaded, (2, len(MARGINS_DB), -1)) * WEIGHTS).sum(axis=-1)
            lost[links], slots[links] = (np.interp(margin_db[links], MARGINS_DB, of) for of in self._averaged[key])
        return lost, slots

    def _alike(self, needed: int, law: int, margin_db: Floats) -> tuple[Floats, Floats]:
        """Loss and slots of links of one law."""
        return self.at(needed, np.full(len(margin_db), law), margin_db)

    def _of(self, needed: int) -> Floats:
        """Tables of success, loss and slots over margins, with a row for each law: (3, laws, margins)."""
        if needed not in self._found:
            if self._success is None:
                least = 10.0 ** (-MARGINS_DB / 10.0)
                self._success = np.concatenate([law.success(least) for law in self._laws])
            forms = [form(needed, self._most, self._success) for form in (link.lost, link.delivered_slots)]
            self._found[needed] = np.reshape([self._success, *forms], (3, len(self._laws), -1))
        return self._found[needed]
