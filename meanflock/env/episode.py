"""One flight of an environment: a stepped flight, what its UAVs observe, and their rewards."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from meanflock.agent.controllers.base import Memory
from meanflock.agent.controllers.policy.network import MAX_MESSAGE, MAX_NEIGHBOURS
from meanflock.agent.controllers.policy.perception import Perception, width
from meanflock.agent.stepped import External, refuse_groups
from meanflock.env.rewards import Terms, weights_of
from meanflock.env.seeds import seed_of
from meanflock.federation.plan import plan_of
from meanflock.settings import scenario_of
from meanflock.stepped import Stepped, source_of
from meanflock.swarm import mission as missions
from meanflock.swarm.counts import count_of
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats, Mask, Rows
from meanflock.swarm.wire.control import FLOAT_OF_BITS
from meanflock.worldsim.flight import ARRIVED, LOST


class Form:
    """What the flights of an environment have in common.

    scenario: what is flown; each flight has its own seed. seed: that of the first flight; None: a fresh one. inputs,
    outputs: numbers of an observation and an action.
    acceleration: bound of the action space. weights: of the terms of the reward.
    """

    def __init__(
        self,
        mission: str | Path | Scenario,
        neighbours: int,
        message: int,
        acceleration: float,
        reward: Mapping[str, float] | None,
        keys: Mapping[str, Any],
    ) -> None:
        """Raises BadInput if an argument cannot be used."""
        self.neighbours = count_of("neighbours:", neighbours, 1, MAX_NEIGHBOURS)
        self.message = count_of("message:", message, 0, MAX_MESSAGE)
        self.acceleration = _acceleration(acceleration)
        self.weights = weights_of(reward)
        source = source_of(mission)
        self.seed = seed_of(mission, keys.get("seed"))
        settings = {key: value for key, value in keys.items() if key.partition(".")[0] not in ("controller", "method")}
        flown = scenario_of(source, settings, method=External)
        refuse_groups(flown, "an environment")
        self.inputs = width(self.neighbours, self.message, flown.dimensions)
        self.outputs = flown.dimensions + self.message
        numbers = Perception(flown, self.neighbours, self.message).broadcast_numbers
        self.scenario = scenario_of(flown, {"controller": {"broadcast_numbers": numbers, "shares": True}})

    def bounds(self) -> Rows:
        """Largest numbers of an action."""
        return np.array([self.acceleration] * (self.outputs - self.message) + [1.0] * self.message)


def _acceleration(value: Any) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = 0.0
    if 0.0 < number < np.inf:
        return number
    raise BadInput(f"acceleration: {value!r}; expected a number greater than 0, m/s²")


class TickResults(NamedTuple):
    """Results of a tick, a row for each UAV.

    rewards: (N,). terms: (N, T), see `rewards.WEIGHTS`. ended: (N,) UAVs that are lost, and when
    the flight is over also those that have arrived.
    """

    rewards: Rows
    terms: Floats
    ended: Mask


class Episode(Stepped):
    """A flight of an environment."""

    def __init__(self, form: Form, seed: int) -> None:
        self.scenario = plan_of(form.scenario.replace(seed=seed)).given
        self._form = form
        self._terms = Terms(self.scenario)
        self._perception = Perception(self.scenario, form.neighbours, form.message)
        everyone = np.arange(self.scenario.uavs)
        plan = missions.starts(self.scenario).astype(FLOAT_OF_BITS[self.scenario.radio.bits_per_float])  # as by radio
        self._memory: Memory = self._perception.init(everyone, plan.astype(np.float64))
        self._take_off()
        self.observations = self._observe()

    @property
    def lost(self) -> Mask:
        """(N,), UAVs that are lost."""
        return self._world.flight.status == LOST

    @property
    def arrived(self) -> Mask:
        """(N,), UAVs that have arrived."""
        return self._world.flight.status == ARRIVED

    def act(self, actions: Floats) -> TickResults:
        """Fly one tick with actions (N, d + W); afterwards `observations` (N, width) are those of the next tick."""
        flight = self._world.flight
        on_way, before = flight.on_way.copy(), flight.status.copy()
        axes = actions.shape[1] - self._form.message
        command, messages = actions[:, :axes], actions[:, axes:] if self._form.message else None
        memory, broadcasts = self._perception.send(self._memory, self.tick, self.states, messages)
        self.step(command, broadcasts)
        self._memory = memory
        self.observations = self._observe()
        arrived, lost = self.arrived, self.lost
        new_lost = lost & (before != LOST)
        new_arrived = arrived & (before != ARRIVED)
        terms = self._terms.after(self.states, command, on_way, new_arrived, new_lost, flight.encounters.collided)
        rewards = np.zeros(len(terms))
        for column, weight in enumerate(self._form.weights.tolist()):
            rewards += np.where(np.isfinite(terms[:, column]), weight * terms[:, column], 0.0)
        return TickResults(rewards, terms, lost | arrived if self.over else lost)

    def _observe(self) -> Floats:
        self._memory, _ = self._perception.receive(self._memory, self.tick, self.received)
        return self._perception.observe(self._memory, self.tick, self.states)
