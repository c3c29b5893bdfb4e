"""The paper's methods: networks that learn the HJB and FPK equations in flight, Algorithms 1 to 3.

The weights of a UAV are one row [ŵ_H0 (54), ŵ_H1 (54), ŵ_F0 (69), ŵ_F1 (69)], in space [81, 81, 209, 209]; a method
shares a contiguous part of it.
The learners fly to the origin. If UAVs have goals of their own, each uses states relative to its goal.
"""

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock import kernels
from meanflock.agent.controllers.base import (
    Broadcast,
    Controller,
    Memory,
    Received,
    Rows,
    Step,
    believed,
    of_kind,
    plausible,
    replaced,
)
from meanflock.agent.controllers.mean_field.learner import MeanFieldLearner
from meanflock.kernels.mean_field.layout import layout_of
from meanflock.swarm import mission, state
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats, States, distinct
from meanflock.swarm.wire.messages import NOBODY

FORGET_S = 1.0  # a UAV that sent nothing for so long does not count as near


class Separation:
    """Repulsion from near UAVs, if `cost.separation` is set.

    The paper's interaction term aligns velocities and does not separate UAVs. With a separation every UAV broadcasts
    its state in every tick, which the radio counts, and adds to its command the negative gradient of a cost that falls
    with distance. The learners do not use it.

    Memory: `believed`, the states of others (M, N, 4); `updated`, the tick in which each was last received, (M, N).
    """

    def __init__(self, scenario: Scenario) -> None:
        self._dt, self._forget_ticks = scenario.dt, FORGET_S / scenario.dt
        self._weight, self._range = scenario.cost.separation, scenario.cost.separation_range

    def init(self, uavs: NDArray[np.intp], plan: States) -> Memory:
        """Memory at take-off, with the states of the mission plan."""
        believed = np.repeat(plan[None], len(uavs), axis=0)
        updated = np.zeros(believed.shape[:2], dtype=np.int32)
        return {"believed": believed, "updated": updated, "uav": uavs.astype(np.int32)}

    def step(
        self, memory: Memory, tick: int, own: States, received: Floats, places: Sequence[Rows]
    ) -> tuple[Memory, Floats]:
        """Returns the memory with the states received, and the acceleration away from near UAVs, (M, 2), m/s².

        Args:
            own: (M, 4). received: (M, N, 4), `believed` with the states just received, all a tick old. places: arrays
                of the places row · N + sender of these.
        """
        last = memory["updated"].copy()
        for place in places:
            last.reshape(-1)[place] = tick
        believed = received.copy()
        if tick:  # predicted at constant velocity
            state.position(believed)[...] += self._dt * state.velocity(received)
        believed[np.arange(len(own)), memory["uav"]] = own
        nearby = np.where((tick - last <= self._forget_ticks)[..., None], believed, np.inf)
        pushed = np.empty((len(own), state.axes(own)))
        kernels.repel(np.ascontiguousarray(own), nearby, self._weight, self._range, pushed)
        return memory | {"believed": believed, "updated": last}, pushed


class MeanField(Controller):
    """Base class of the paper's learning methods."""

    dimensions = (2, 3)
    guided = True
    weights: int
    learns_density = True
    shares_value = shares_density = False  # whether the federation averages these networks
    exchanged_period_ticks = 200  # `period_ticks` with `learner.exchanged_rounds`
    diagnostics: tuple[str, ...] = ("hjb_residual", "fpk_residual", "phi_G")

    def __init__(self, options: Any, scenario: Scenario) -> None:
        super().__init__(options, scenario)
        layout = layout_of(scenario.dimensions)
        self.weights = layout.floats
        self.shared = slice(  # the part of the weights that the federation averages
            0 if self.shares_value else layout.density.start,
            layout.floats if self.shares_density else layout.density.start,
        )
        self.parameters = self.shared.stop - self.shared.start
        self.parts = (layout.value_features,) * (2 * self.shares_value)
        self.parts += (layout.density_features,) * (2 * self.shares_density)
        if scenario.learner.exchanged_rounds:
            self.period_ticks = self.exchanged_period_ticks
        self._first_command = round(scenario.learner.act_after_s / scenario.dt)  # tick
        # Ticks between two broadcasts of the own state; 0: none after the mission plan.
        self.state_period = scenario.federation.state_period
        self.separation = Separation(scenario) if scenario.cost.separation else None
        self.pairwise = self.state_period > 0 or self.separation is not None
        if self.state_period and self.separation is not None and self.learns_density:
            raise BadInput(
                f"`federation.state_period` {self.state_period} and `cost.separation` {scenario.cost.separation}: with "
                "a separation every state is shared in every tick; leave one of them out"
            )
        self._plausible = plausible(scenario)

    @cached_property
    def learner(self) -> MeanFieldLearner:
        """The networks, made at first use, because their tables take a millisecond."""
        return MeanFieldLearner(self.scenario, learns_density=self.learns_density)

    def init(self, uavs: NDArray[np.intp], plan: States) -> Memory:
        goals = mission.goal_states(self.scenario)
        if goals.any() or self.scenario.is_guided:
            memory: Memory = {"weights": self.learner.init_to(goals, uavs, plan), "goal": goals[uavs]}
        else:
            memory = {"weights": self.learner.init(len(uavs), plan)}
        if self.state_period:  # states of the mission plan, later replaced by received ones
            memory |= {"known_states": np.repeat(plan[None], len(uavs), axis=0), "uav": uavs.astype(np.int32)}
        if self.separation is not None:
            memory |= self.separation.init(uavs, plan)
        return memory

    def guide(self, memory: Memory, rows: Rows, goals: Floats) -> Memory:
        return memory | {"goal": replaced(memory["goal"], rows, state.at_rest(goals))}

    def step(self, memory: Memory, tick: int, own: States, received: Sequence[Received]) -> Step:
        weights = memory["weights"]
        known_states = None
        refused = NOBODY
        goal = memory.get("goal")
        if self.state_period:
            known_states, places, refused = self._receive_states(memory["known_states"], received)
            if self.learns_density and places:  # only rows that received a state
                seen = known_states if goal is None else known_states - goal[:, None]
                fresh = distinct(np.concatenate(places) // known_states.shape[1])
                weights = self.learner.refit(weights, fresh, seen)
            known_states[np.arange(len(own)), memory["uav"]] = own
            memory = memory | {"known_states": known_states}
        states = own if goal is None else own - goal
        known_states = known_states if goal is None or known_states is None else known_states - goal[:, None]
        weights, numbers = self.learner.step(weights, states, known_states)
        axes = state.axes(own)
        broadcasts, action = self.state_period and tick and tick % self.state_period == 0, numbers[:, :axes]
        if self.separation is not None:
            states_received, places, refused = self._receive_states(memory["believed"], received)
            memory, pushed = self.separation.step(memory, tick, own, states_received, places)
            action, broadcasts = action + pushed, tick > 0
        if tick < self._first_command:
            action = np.zeros_like(action)
        return Step(
            memory | {"weights": weights},
            action,
            numbers[:, axes:] if self.learns_density else numbers[:, axes::2],  # without e_F
            (Broadcast(own),) if broadcasts else (),
            refused,
        )

    def get(self, memory: Memory) -> Floats:
        return memory["weights"][:, self.shared]

    def set(self, memory: Memory, rows: Rows, models: Floats) -> Memory:
        weights = memory["weights"].copy()
        weights[rows, self.shared] = models
        return memory | {"weights": weights}

    def report(self, memory: Memory) -> Floats:
        return memory["weights"]

    def _receive_states(
        self, known_states: Floats, received: Sequence[Received]
    ) -> tuple[Floats, list[Rows], NDArray[np.int32]]:
        """Update the states that rows know, (M, N, 4), by the received ones.

        Returns:
            The states; row · N + sender of each received state, an array for each batch; and the senders of implausible
            states.
        """
        frames, refused = believed(of_kind(received, known_states.shape[-1]), self._plausible)
        known_states = known_states.copy()
        table = known_states.reshape(-1, known_states.shape[-1])
        places = []
        for states in frames:
            sent, row = states.links.T
            place = row * known_states.shape[1] + states.source.take(sent)
            table[place] = states.payload.take(sent, axis=0)
            places.append(place)
        return known_states, places, refused


class Hjb(MeanField):
    """Learns the value; broadcasts its state in every tick to every UAV in range."""

    name = "hjb"
    learns_density = False
    diagnostics = ("hjb_residual", "phi_G")

    def __init__(self, options: Any, scenario: Scenario) -> None:
        super().__init__(options, scenario)
        self.state_period, self.pairwise = 1, True


class Mfg(MeanField):
    """Learns value and density; sends the initial states only, or states every n_s ticks."""

    name = "mfg"


class MfgflH(MeanField):
    """Like `mfg`; the federation averages the value models."""

    name = "mfgfl-h"
    shares_value = True


class MfgflF(MeanField):
    """Like `mfg`; the federation averages the density models."""

    name = "mfgfl-f"
    shares_density = True


class MfgflHf(MeanField):
    """Like `mfg`; the federation averages both models, every 200 ticks; with exchanged rounds every 100."""

    name = "mfgfl-hf"
    shares_value = shares_density = True
    period_ticks = 200
    exchanged_period_ticks = 100
