"""An aggregation rule in a file: uploads over bad links, which are lost more often, count for more when they arrive.

A message is sent until it had enough good slots. From the mean number of slots of a UAV's uploads follows how likely a
slot of its link is good, and from that the probability p that an upload arrives. The global model moves by the mean of
(model − last global model) / p over all who were to upload; a model that is lost adds nothing. So its expectation is
the mean of all models (Horvitz and Thompson 1952). For models that fit into one message.
"""

from functools import cache
from math import comb

import numpy as np

import meanflock as mf


@cache
def arrival(need: int, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Mean slots of messages that arrive, ascending, and the probability p to arrive: `need` good slots of `most`."""
    good = np.linspace(1.0, 0.05, 96)[:, None]  # of a slot
    slots = np.arange(need, most + 1)
    ways = np.array([comb(slot - 1, need - 1) for slot in slots])
    chance = ways * good**need * (1.0 - good) ** (slots - need)
    return (chance * slots).sum(axis=1) / chance.sum(axis=1), chance.sum(axis=1)


class InverseProbability(mf.Aggregator):
    name = "inverse-probability"

    def init(self, parameters):
        most, nothing = self.scenario.radio.latency_threshold_slots, np.zeros(self.scenario.uavs)
        return {"model": np.zeros(parameters), "need": np.full(1, most), "slots": nothing, "uploads": nothing}

    def step(self, state, uploads):
        by_radio = uploads.slots > 0  # the model of the UAV that averages always arrives
        need = np.minimum(state["need"], uploads.slots[by_radio].min(initial=state["need"][0]))
        slots, count = state["slots"].copy(), state["uploads"].copy()
        slots[uploads.uavs] += uploads.slots
        count[uploads.uavs] += 1.0
        mean = slots[uploads.uavs] / count[uploads.uavs]
        chance = np.interp(mean, *arrival(int(need[0]), self.scenario.radio.latency_threshold_slots))
        weights = 1.0 / np.where(by_radio, np.maximum(chance, 0.05), 1.0)  # at most twenty
        last = state["model"] if state["uploads"].any() else uploads.mean
        model = last + weights @ (uploads.models - last) / self.scenario.participants
        return {"model": model, "need": need, "slots": slots, "uploads": count}, model
