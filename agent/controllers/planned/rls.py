"""Recursive least squares (Ljung, System Identification, 2nd ed. 1999, section 11.2): estimates drag and wind in
flight.

Every UAV knows its trajectory (`trajectory.py`), but neither drag nor wind. From the acceleration beyond its command,
y = −c0 v + c0 v_o + noise, it estimates θ = (c0, c0 v_o), and its commands cancel the estimated drag and wind. The
federation averages θ.
"""

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from meanflock.agent.controllers import base
from meanflock.agent.controllers.base import Memory, Received, Step
from meanflock.agent.controllers.cruise import CRUISE_M_S, CruiseSpeed
from meanflock.agent.controllers.elimination import product
from meanflock.agent.controllers.planned.plan import PlannedLearner, tracking
from meanflock.swarm import state
from meanflock.swarm.state import States

NUMBERS = 3  # of θ: drag, 1/s; drag × wind along x and y, m/s²
LOWEST, HIGHEST = np.array([0.0, -3.0, -3.0]), np.array([1.0, 3.0, 3.0])  # bounds of the estimates in flight


class Rls(PlannedLearner):
    """Follows the trajectory of `plan`; identifies drag and wind by recursive least squares.

    a = a* + k_p (r* − r) + k_v (v* − v) + θ1 v − (θ2, θ3). With `share = false` every UAV uses its own estimate
    only.
    """

    name = "rls"
    learned = "estimate"
    weights = NUMBERS
    diagnostics = ("tracking_cost", "drag", "push_x", "push_y")
    period_ticks = 20

    class Options(base.Options, frozen=True):
        """The options of `rls`."""

        speed_m_s: CruiseSpeed = CRUISE_M_S
        share: Annotated[bool, Meta(description="whether the federation averages the estimates")] = True
        position_gain_1_s2: Annotated[float, Meta(gt=0, description="k_p, 1/s²")] = 4.0
        velocity_gain_1_s: Annotated[float, Meta(gt=0, description="k_v, 1/s")] = 4.0
        prior: Annotated[float, Meta(gt=0, description="std of θ before take-off, about zero, 1/s and m/s²")] = 0.3
        noise: Annotated[float, Meta(gt=0, description="assumed std of measured accelerations, m/s²")] = 1.0
        forgetting: Annotated[float, Meta(gt=0, le=1, description="λ, forgetting factor per tick, 1")] = 1.0

    @property
    def _prior_variance(self) -> float:
        """Variance of each number of θ before take-off, divided by that of the noise."""
        return float((self.options.prior / self.options.noise) ** 2)

    def init(self, uavs: NDArray[np.intp], plan: States) -> Memory:
        rows = len(uavs)
        return super().init(uavs, plan) | {
            "estimate": np.zeros((rows, NUMBERS)),
            "covariance": np.tile(np.eye(NUMBERS) * self._prior_variance, (rows, 1, 1)),
            "velocity": np.zeros((rows, state.axes(plan))),  # and command, of `tick`
            "command": np.zeros((rows, state.axes(plan))),
        }

    def step(self, memory: Memory, tick: int, own: States, received: Sequence[Received]) -> Step:
        options, moving = self.options, state.velocity(own)
        off, acceleration = self._off(memory["uav"], tick, own)
        memory = memory | self._learn(memory, tick, moving)
        estimate = np.clip(memory["estimate"], LOWEST, HIGHEST)
        command = acceleration - options.position_gain_1_s2 * off[..., 0] - options.velocity_gain_1_s * off[..., 1]
        command += estimate[:, :1] * moving - estimate[:, 1:]
        after = {"velocity": moving.copy(), "command": command, "tick": np.full(len(own), tick, dtype=np.int32)}
        reported = np.concatenate([tracking(off)[:, None], memory["estimate"]], axis=1)
        return Step(memory | after, command, reported)

    def _learn(self, memory: Memory, tick: int, moving: state.Vectors) -> Memory:
        """Estimate and covariance with the data of the last tick; empty after a pause, or on the ground."""
        fresh = self._follows(memory, tick)
        if not fresh.any():
            return {}
        estimate = memory["estimate"]
        covariance = memory["covariance"]
        before = memory["velocity"]
        beyond = (moving - before) / self.scenario.dt - memory["command"]
        for axis in range(moving.shape[1]):
            features = np.zeros((len(moving), NUMBERS))  # zeros for rows that do not learn, which leave them unchanged
            features[:, 0], features[:, 1 + axis] = -before[:, axis] * fresh, fresh
            spread = product(covariance, features[:, :, None])
            gain = spread / (1.0 + product(features[:, None, :], spread))
            missed = beyond[:, axis] - product(features[:, None, :], estimate[:, :, None])[:, 0, 0]
            estimate = estimate + gain[..., 0] * missed[:, None]
            covariance = covariance - gain * spread.transpose(0, 2, 1)
        decay = np.where(fresh, self.options.forgetting, 1.0)
        # The covariance never exceeds the prior: without new data, as at the goal, forgetting would let it grow.
        trace, most = covariance.trace(axis1=1, axis2=2), NUMBERS * self._prior_variance
        decay = np.maximum(decay, np.minimum(1.0, trace / most))
        return {"estimate": estimate, "covariance": covariance / decay[:, None, None]}
