"""Curves of loss and latency over the margin of a link, as tables: a closed form costs an interpolation.

The margin is the mean SNR over the SNR that a slot needs, in dB.
"""

import numpy as np
from numpy.typing import NDArray

from meanflock.channel import link, tails
from meanflock.channel.gains import Gains
from meanflock.swarm.state import Floats

LOWEST_DB, HIGHEST_DB, PER_DB = -40, 60, 20  # margins beyond are taken as the nearest of these
MARGINS_DB = np.arange(LOWEST_DB * PER_DB, HIGHEST_DB * PER_DB + 1) / PER_DB
# Of a shadow: an even grid is exact to 4e-9, where Gauss–Hermite's nodes miss a sharp curve by 2 %.
NODES = np.linspace(-6.0, 6.0, 241)
WEIGHTS = np.exp(-0.5 * NODES**2) / np.exp(-0.5 * NODES**2).sum()


class Curves:
    """Loss and slots of messages over links with some laws of fading, which send in `most` slots at most."""

    def __init__(self, gains: Gains, most: int) -> None:
        self._gains, self._most = gains, most
        self._is_steady = np.array([law.is_steady for law in gains.laws])
        self._success: Floats | None = None  # (laws, margins)
        self._found: dict[int, tuple[Floats, Floats]] = {}  # by needed slots
        self._averaged: dict[tuple[int, int, float], tuple[Floats, Floats]] = {}

    def at(self, needed: int, law: NDArray[np.intp], margin_db: Floats) -> tuple[Floats, Floats]:
        """Probability of loss, and E[slots; delivered], of links with given margins; each (K,).

        Args:
            needed: good slots that the message takes. law: (K,) index of each link's law, or a single one.
        """
        lost, slots = self._of(needed)
        place = np.clip((margin_db - LOWEST_DB) * PER_DB, 0.0, len(MARGINS_DB) - 1.0)
        index = np.minimum(place.astype(np.intp), len(MARGINS_DB) - 2)
        part = np.where(self._is_steady[law], np.floor(place - index), place - index)  # a step has no middle
        first = law * len(MARGINS_DB) + index
        return tuple(  # type: ignore[return-value]
            table.take(first) + part * (table.take(first + 1) - table.take(first)) for table in (lost, slots)
        )

    def shadowed(self, needed: int, law: int, margin_db: Floats, sigma_db: Floats) -> tuple[Floats, Floats]:
        """The same on average over a shadow that is held for the whole message, with deviations (K,) in dB."""
        lost, slots = np.empty(len(margin_db)), np.empty(len(margin_db))
        for sigma in np.unique(sigma_db).tolist():
            links = sigma_db == sigma
            if sigma == 0.0:
                lost[links], slots[links] = self.at(needed, np.array(law), margin_db[links])
                continue
            if self._is_steady[law]:  # P[margin + shadow ≥ 0], where the even grid would have steps
                share = tails.normal_below(margin_db[links] / sigma) if needed <= self._most else 0.0
                lost[links], slots[links] = 1.0 - share, needed * share
                continue
            key = (needed, law, sigma)
            if key not in self._averaged:
                shaded = self.at(needed, np.array(law), MARGINS_DB[:, None] + sigma * NODES)
                self._averaged[key] = (shaded[0] * WEIGHTS).sum(axis=-1), (shaded[1] * WEIGHTS).sum(axis=-1)
            lost[links], slots[links] = (np.interp(margin_db[links], MARGINS_DB, of) for of in self._averaged[key])
        return lost, slots

    def _of(self, needed: int) -> tuple[Floats, Floats]:
        """Tables of loss and slots over margins, the laws one after another."""
        if needed not in self._found:
            if self._success is None:
                least = 10.0 ** (-MARGINS_DB / 10.0)
                self._success = np.concatenate([law.success(least) for law in self._gains.laws])
            self._found[needed] = (
                link.lost(needed, self._most, self._success),
                link.delivered_slots(needed, self._most, self._success),
            )
        return self._found[needed]
