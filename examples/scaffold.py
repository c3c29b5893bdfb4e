"""A controller and a rule in a file: local steps with control variates (SCAFFOLD, Karimireddy et al. 2020).

The UAVs meet at the point whose mean squared distance to all of them is least. Each knows the gradient of its own
distance only. It uploads [y, s]: its point y, and the mean s of its last K corrected gradients, so that its control
variate changes by s − c. All take part in every round: federation.fraction=1.
"""

import numpy as np

import meanflock as mf

STEPS, RATE = 10, 0.05  # K, steps before a round, and η, size of a step


class Scaffold(mf.Controller):
    name = "scaffold"
    parameters = 4
    period_ticks = 20

    def init(self, uavs, plan):
        start = np.hstack([plan[uavs, :2], np.zeros((len(uavs), 2))])
        return {"model": start, "global": start, "variate": start[:, 2:]}  # [y, s], [x, c] and c_i

    def step(self, memory, tick, own, received):
        (model, mean), (start, shared) = (np.split(memory[name], 2, axis=1) for name in ("model", "global"))
        variate, since = memory["variate"], tick % self.scenario.period_ticks
        if since == 0 and tick:  # the upload is on its way: c_i ← c_i − c + s
            start, variate = model, variate - shared + mean
        if since >= self.scenario.period_ticks - STEPS:  # y ← y − η (g_i(y) − c_i + c)
            model = model - RATE * (model - own[:, :2] - variate + shared)
            mean = (start - model) / (STEPS * RATE)
        after = {"model": np.hstack([model, mean]), "global": np.hstack([start, shared]), "variate": variate}
        return mf.Step(after, 0.02 * (model - own[:, :2]) - 0.3 * own[:, 2:])

    def get(self, memory):
        return memory["model"]

    def set(self, memory, rows, models):
        after = {name: memory[name].copy() for name in ("model", "global")}
        after["model"][rows] = after["global"][rows] = models
        return memory | after


class ScaffoldRule(mf.Aggregator):
    name = "scaffold"

    def init(self, parameters):
        return {"shared": np.zeros(parameters // 2)}

    def step(self, state, uploads):  # c ← c + |S|/N · mean of (s − c)
        model, mean = np.split(uploads.mean, 2)
        shared = state["shared"] + len(uploads.uavs) / self.scenario.uavs * (mean - state["shared"])
        return {"shared": shared}, np.concatenate([model, shared])
