"""Channel without fading: every message is delivered, in the least number of slots."""

import numpy as np

from meanflock.channel.base import Carried, Channel, Floats
from meanflock.channel.link import slots_needed


class Ideal(Channel):
    """No fading: every message takes ⌈bits / (θ W_o log₂(1 + η))⌉ slots, at any distance and for any D_M."""

    name = "ideal"

    def transmit(self, distance_m: Floats, bits: int, rng: np.random.Generator) -> Carried:
        links = len(distance_m)
        return np.full(links, slots_needed(self.scenario.radio, bits), dtype=np.int64), np.ones(links, dtype=bool)

    def expected(self, distance_m: Floats, bits: int) -> tuple[float, float]:
        return 0.0, float(len(distance_m) * slots_needed(self.scenario.radio, bits))

    def least_slots(self, bits: int) -> int:
        return slots_needed(self.scenario.radio, bits)
