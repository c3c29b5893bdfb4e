"""The vector environment of Gymnasium: one policy, whose rows are flights × UAVs."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from meanflock.env.episode import Episode, Form
from meanflock.env.seeds import Seeds
from meanflock.launch import memory
from meanflock.runs import Run
from meanflock.swarm.counts import count_of
from meanflock.swarm.errors import BadInput
from meanflock.swarm.plugins.guard import as_floats
from meanflock.swarm.state import Floats, Mask, Rows

_SUMMARIES = 100  # that are kept; one is 50 KiB for 25 UAVs, because it lists their links


class VectorFlock(VectorEnv[Floats, Floats, Floats]):
    """Several flights; made by `vector_env`.

    A row is terminated once, when its UAV is lost, or has arrived by the end of the flight; otherwise the end of the
    flight truncates it. The row of a lost UAV is then inactive, with reward 0, until its flight begins anew.

    infos: `active`, mask of the rows whose action this step flew: all but those of UAVs that were lost before, and rows
    of a flight that begins. `lost` and `arrived`, masks of the rows; `terms` (rows, T) of the rewards, in the order of
    `meanflock.env.TERMS`; `seed` of the flight of each row. summaries: summaries of the last flights that have ended,
    in order; at least a hundred, and at least one for each flight that flies at once.
    """

    def __init__(self, form: Form, flights: int) -> None:
        flights = count_of("flights:", flights, 1)
        memory.check_environment(form.scenario.uavs, flights, form.message)
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
        self._seeds = Seeds(form.seed)
        self._episodes: list[Episode] = []

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats, dict[str, Any]]:
        """Begins all flights anew. `options` are ignored.

        Args:
            seed: that of the first flight, the others follow on; or one for each flight. None: the seeds after the last
                given ones; if none were given, fresh ones of the system. The attribute `np_random` is a generator of
                the seed of the first flight; the flights do not draw from it.

        Raises:
            BadInput: the seed cannot be used.
        """
        self._episodes = [Episode(self._form, each) for each in self._seeds.begin(seed, self.flights)]
        self._np_random, self._np_random_seed = np_random(self._episodes[0].scenario.seed)
        return self._observations(), {"seed": self._flown_seeds()}

    def step(self, actions: Floats) -> tuple[Floats, Rows, Mask, Mask, dict[str, Any]]:
        """Flies one tick of every flight with actions (rows, d + W).

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
        terminated, truncated, lost, arrived, active = (np.zeros(rows, dtype=bool) for _ in range(5))
        for number, episode in enumerate(self._episodes):
            part = slice(number * uavs, (number + 1) * uavs)
            if episode.over:
                self._episodes[number] = Episode(self._form, self._seeds.take())
                continue
            active[part] = ~episode.lost
            outcome = episode.act(table[part])
            rewards[part] = outcome.rewards
            terms[part] = outcome.terms
            terminated[part] = outcome.ended & active[part]
            lost[part], arrived[part] = episode.lost, episode.arrived
            if episode.over:
                truncated[part] = ~outcome.ended
                self.summaries.append(episode.finish().summary)
        del self.summaries[: -max(_SUMMARIES, self.flights)]
        infos = {"active": active, "lost": lost, "arrived": arrived, "terms": terms, "seed": self._flown_seeds()}
        return self._observations(), rewards, terminated, truncated, infos

    def runs(self) -> list[Run]:
        """Ends the flights and returns their runs."""
        return [episode.finish() for episode in self._episodes]

    def close_extras(self, **_: Any) -> None:
        """Forget the flights."""
        self._episodes = []

    def _flown_seeds(self) -> NDArray[np.int64]:
        """The seed of the flight of each row."""
        return np.repeat([episode.scenario.seed for episode in self._episodes], self._form.scenario.uavs)

    def _observations(self) -> Floats:
        return np.concatenate([episode.observations for episode in self._episodes])
