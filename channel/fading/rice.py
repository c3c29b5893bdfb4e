"""Rice fading: the amplitude of a line of sight plus scattered paths, Eq. Rice, independent in every slot.

The printed density writes I₀(zξ/χ²) for I₀(ζξ/χ²), and Rayleigh as ζ = 0 for ξ = 0; we read both as misprints.
"""

import numpy as np

from meanflock import kernels
from meanflock.channel import link
from meanflock.channel.base import Carried, Channel, Floats
from meanflock.channel.link import slots_needed, squared_threshold
from meanflock.swarm.scenario import Scenario


class Rice(Channel):
    """Rician fading, slot by slot. A message is delivered after K slots whose SNR reaches η, and lost after D_M slots.
    The constants are the keys of `[radio]`."""

    name = "rice"

    def __init__(self, options: Channel.Options, scenario: Scenario) -> None:
        super().__init__(options, scenario)
        self._radio = scenario.radio
        self._needed: dict[int, int] = {}  # slots, by bits
        self._expected: dict[int, tuple[float, float]] = {}  # of one link, by bits, without path loss
        self._alike = None if self._radio.path_loss_exponent else squared_threshold(self._radio, np.ones(1))

    def transmit(self, distance_m: Floats, bits: int, rng: np.random.Generator) -> Carried:
        """Draws an amplitude in every slot for each link that is still busy, in link order."""
        radio = self._radio
        links = len(distance_m)
        if bits not in self._needed:
            self._needed[bits] = slots_needed(radio, bits)
        thresholds = squared_threshold(radio, distance_m) if self._alike is None else self._alike
        slots = np.empty(links, dtype=np.int64)
        missing = np.full(links, self._needed[bits])
        busy = np.arange(links)
        left = links
        for slot in range(1, radio.latency_threshold_slots + 1):
            normal = rng.standard_normal((left, 2))
            left = kernels.fade(normal, radio.rice_xi, radio.rice_chi, thresholds, slot, busy, missing, slots)
            if not left:
                break
        delivered = np.ones(links, dtype=bool)
        delivered[busy[:left]] = False
        return slots, delivered

    def expected(self, distance_m: Floats, bits: int) -> tuple[float, float]:
        if self._alike is None:
            return link.expected(self._radio, distance_m, bits)
        if bits not in self._expected:
            self._expected[bits] = link.expected(self._radio, np.ones(1), bits)
        outages, slots = self._expected[bits]
        return len(distance_m) * outages, len(distance_m) * slots

    def least_slots(self, bits: int) -> int:
        return slots_needed(self._radio, bits)
