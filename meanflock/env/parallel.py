"""The environment of PettingZoo: each UAV is an agent."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from gymnasium.utils.seeding import np_random
from pettingzoo import ParallelEnv

from meanflock.env.episode import Episode, Form
from meanflock.env.seeds import Seeds
from meanflock.launch import memory
from meanflock.runs import Run
from meanflock.swarm.errors import BadInput
from meanflock.swarm.state import Floats, States


class ParallelFlock(ParallelEnv[str, Floats, Floats]):
    """A flight whose UAVs are agents; made by `parallel_env`.

    All agents act until the flight is over, those that have arrived too; a UAV that is lost leaves. `reset` without a
    seed takes the one after the last given seed; if none was given, a fresh one of the system.

    agents: the UAVs that act. info of an agent: of `reset`, `seed` of the flight; of `step`, `lost`, `arrived`, and
    `terms` of its reward, in the order of `meanflock.env.TERMS`. state_space: the space of `state`. np_random,
    np_random_seed: a generator that `reset` makes of the seed of the flight, and that seed; None before. The flight
    itself does not draw from it.
    """

    metadata: dict[str, Any] = {"name": "meanflock_v0", "render_modes": []}  # noqa: RUF012  # PettingZoo reads it
    render_mode = None

    def __init__(self, form: Form) -> None:
        memory.check_environment(form.scenario.uavs, 1, form.message)
        self._form = form
        self.possible_agents = [f"uav_{uav}" for uav in range(form.scenario.uavs)]
        self.agents: list[str] = []
        self._row = {agent: uav for uav, agent in enumerate(self.possible_agents)}
        bounds = form.bounds()
        self.observation_spaces = {
            agent: Box(-np.inf, np.inf, (form.inputs,), np.float64) for agent in self.possible_agents
        }
        self.action_spaces = {agent: Box(-bounds, bounds, dtype=np.float64) for agent in self.possible_agents}
        self.state_space = Box(-np.inf, np.inf, (form.scenario.uavs, form.scenario.state_numbers), np.float64)
        self.np_random: np.random.Generator | None = None
        self.np_random_seed: int | None = None
        self._seeds = Seeds(form.seed)
        self._episode: Episode | None = None

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Floats], dict[str, dict[str, Any]]]:
        """Begins another flight. `options` are ignored.

        Raises:
            BadInput: the seed cannot be used.
        """
        (chosen,) = self._seeds.begin(seed, 1)
        self._episode = Episode(self._form, chosen)
        self.np_random, self.np_random_seed = np_random(chosen)
        self.agents = list(self.possible_agents)
        observations = dict(zip(self.agents, self._episode.observations, strict=True))
        return observations, {agent: {"seed": chosen} for agent in self.agents}

    def step(self, actions: dict[str, Floats]) -> tuple[dict[str, Any], ...]:
        """Flies one tick with an action of each agent.

        Raises:
            BadInput: an agent has no action, or one of a wrong shape or dtype; or no flight has begun, or it is over.
                Nothing was flown.
        """
        episode = self._episode
        if episode is None or not self.agents:
            raise BadInput("step: no flight; call reset first")
        outcome = episode.act(self._rows(actions))
        agents, over = self.agents, episode.over
        rows = [self._row[agent] for agent in agents]
        ended, lost, arrived = (mask.tolist() for mask in (outcome.ended, episode.lost, episode.arrived))
        rewards = outcome.rewards.tolist()
        observations, terms = episode.observations, outcome.terms
        if over or any(lost):
            self.agents = [] if over else [agent for agent, row in zip(agents, rows, strict=True) if not lost[row]]
        pairs = list(zip(agents, rows, strict=True))
        return (
            {agent: observations[row] for agent, row in pairs},
            {agent: rewards[row] for agent, row in pairs},
            {agent: ended[row] for agent, row in pairs},
            {agent: over and not ended[row] for agent, row in pairs},
            {agent: {"lost": lost[row], "arrived": arrived[row], "terms": terms[row]} for agent, row in pairs},
        )

    def state(self) -> States:
        """The states [x, y, vx, vy] of all UAVs, (N, 4), in m and m/s, those of lost UAVs included.

        Raises:
            BadInput: no flight has begun.
        """
        if self._episode is None:
            raise BadInput("state: no flight; call reset first")
        return self._episode.states.copy()

    def observation_space(self, agent: str) -> Box:
        """The space of an agent's observations."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Box:
        """The space of an agent's actions."""
        return self.action_spaces[agent]

    def render(self) -> None:
        """Nothing is drawn."""

    def close(self) -> None:
        """Ends the flight."""
        self._episode, self.agents = None, []

    def finish(self) -> Run:
        """Ends the flight and returns its run, with summary, states and events; raises BadInput before `reset`."""
        if self._episode is None:
            raise BadInput("finish: no flight; call reset first")
        self.agents = []
        return self._episode.finish()

    def _rows(self, actions: Mapping[str, Any]) -> Floats:
        """The actions of all UAVs; those of lost UAVs are 0."""
        if not isinstance(actions, Mapping):
            raise BadInput(
                f"step: {type(actions).__name__}; give a dict of an action for each agent; nothing was flown"
            )
        acting = set(self.agents)
        if absent := acting - actions.keys():
            raise BadInput(f"step: no action of {min(absent, key=self._row.__getitem__)}; nothing was flown")
        table = np.zeros((len(self.possible_agents), self._form.outputs))
        for agent, action in actions.items():
            if agent not in acting:
                raise BadInput(f"step: {agent!r} is no agent of this flight any more; nothing was flown")
            try:
                numbers = np.asarray(action)
            except ValueError:  # rows of several lengths
                numbers = np.array(None)
            if numbers.dtype.kind not in "fiu" or numbers.shape != table.shape[1:]:
                raise BadInput(
                    f"step: the action of {agent} is {numbers.dtype} {numbers.shape}; expected numbers of shape "
                    f"{table.shape[1:]}; nothing was flown"
                )
            table[self._row[agent]] = numbers
        return table
