"""The vector environment of Gymnasium: one policy, whose rows are flights × UAVs."""

from typing import Any

import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from meanflock.env.episode import Episode, Form
from meanflock.runs import Run
from meanflock.swarm.errors import BadInput
from meanflock.swarm.plugins.guard import as_floats
from meanflock.swarm.state import Floats, Mask, Rows


class VectorFlock(VectorEnv[Floats, Floats, Floats]):
    """Several flights; made by `vector_env`.

    A row is terminated when its UAV is lost, or has arrived by the end of the flight; otherwise the end of the flight
    truncates it. The row of a lost UAV stays terminated, with reward 0, until its flight begins anew.

    infos: `lost` and `arrived`, masks of the rows; `terms` (rows, T) of the rewards, in the order of
    `meanflock.env.TERMS`. summaries: summaries of the flights that have ended, in order.
    """

    def __init__(self, form: Form, flights: int) -> None:
        if not isinstance(flights, int) or flights < 1:
            raise BadInput(f"flights: {flights!r}; expected a number of at least 1")
        self._form = form
        self.metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}
        self.flights = flights
        self.num_envs = flights * form.scenario.uavs
        bounds = form.bounds()
        self.single_observation_space = Box(-np.inf, np.inf, (form.inputs,), np.float64)
        self.single_action_space = Box(-bounds, bounds, dtype=np.float64)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.summaries: list[dict[str, Any]] = []
        self._next_seed = form.scenario.seed
        self._episodes: list[Episode] = []

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats, dict[str, Any]]:
        """Begins all flights anew, with seeds from `seed` on, or those after the last. `options` are ignored."""
        if isinstance(seed, list):
            raise BadInput("reset: give one seed; flight f has seed + f")
        if seed is not None:
            self._next_seed = seed
        self._episodes = [self._begun() for _ in range(self.flights)]
        return self._observations(), {}

    def step(self, actions: Floats) -> tuple[Floats, Rows, Mask, Mask, dict[str, Any]]:
        """Flies one tick of every flight with actions (rows, 2 + W).

        Raises:
            BadInput: the actions have a wrong shape or dtype, or no flight has begun. Nothing was flown.
        """
        if not self._episodes:
            raise BadInput("step: no flight; call reset first")
        try:
            table = as_floats("actions", actions, (self.num_envs, self._form.outputs))
        except (TypeError, ValueError) as error:
            raise BadInput(f"step: {error}; nothing was flown") from error
        rows, uavs = self.num_envs, self._form.scenario.uavs
        rewards, terms = np.zeros(rows), np.zeros((rows, len(self._form.weights)))
        terminated, truncated, lost, arrived = (np.zeros(rows, dtype=bool) for _ in range(4))
        for number, episode in enumerate(self._episodes):
            part = slice(number * uavs, (number + 1) * uavs)
            if episode.over:
                self._episodes[number] = self._begun()
                continue
            outcome = episode.act(table[part])
            rewards[part] = outcome.rewards
            terms[part] = outcome.terms
            terminated[part] = outcome.ended
            lost[part], arrived[part] = episode.lost, episode.arrived
            if episode.over:
                truncated[part] = ~outcome.ended
                self.summaries.append(episode.finish().summary)
        infos = {"lost": lost, "arrived": arrived, "terms": terms}
        return self._observations(), rewards, terminated, truncated, infos

    def runs(self) -> list[Run]:
        """Ends the flights and returns their runs."""
        return [episode.finish() for episode in self._episodes]

    def close_extras(self, **_: Any) -> None:
        """Forget the flights."""
        self._episodes = []

    def _begun(self) -> Episode:
        self._next_seed += 1
        return Episode(self._form, self._next_seed - 1)

    def _observations(self) -> Floats:
        return np.concatenate([episode.observations for episode in self._episodes])
