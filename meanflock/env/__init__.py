"""Environments for reinforcement learning, and the policies that they train; see [train a policy](train-a-policy.md).

Import it separately: `import meanflock.env`. The environments need the extra `rl`.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from meanflock.agent.controllers.policy.network import MAX_MESSAGE, MAX_NEIGHBOURS, Network, read
from meanflock.agent.controllers.policy.network import save as _save
from meanflock.env.rewards import TERMS, WEIGHTS
from meanflock.settings import with_settings
from meanflock.swarm import paths
from meanflock.swarm.counts import count_of
from meanflock.swarm.errors import BadInput, available
from meanflock.swarm.plugins.guard import as_floats
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats, Vectors

if TYPE_CHECKING:
    from meanflock.env.parallel import ParallelFlock
    from meanflock.env.vector import VectorFlock

__all__ = ["TERMS", "WEIGHTS", "Policy", "parallel_env", "policy", "save_policy", "vector_env"]


@with_settings
def parallel_env(
    mission: str | Path | Scenario = "paper",
    *,
    neighbours: int = 4,
    message: int = 0,
    acceleration: float = 3.0,
    reward: Mapping[str, float] | None = None,
    **keys: Any,
) -> "ParallelFlock":
    """An environment of PettingZoo with an agent for each UAV, `uav_0` … of a flight.

    Args:
        mission: what is flown, as for `mf.fly`.
        neighbours: K, number of the nearest UAVs that a UAV observes.
        message: W, numbers of the message that a UAV broadcasts in every tick; their bits are counted.
        acceleration: largest acceleration of the action space along an axis, m/s². Larger ones are flown as they are.
        reward: weights of terms of the reward, by name, in place of those of `meanflock.env.WEIGHTS`.
        keys: `uavs`, `seed`, `duration`, or any dotted scenario key. `seed` is that of the first flight. Without it
            each flight has a fresh seed of the system, unless a Scenario or a file has one; `infos` says which.

    Raises:
        BadInput: an argument cannot be used, or the extra `rl` is not installed.
    """
    with available("meanflock.env.parallel_env", "rl"):
        from meanflock.env.episode import Form
        from meanflock.env.parallel import ParallelFlock
    return ParallelFlock(Form(mission, neighbours, message, acceleration, reward, keys))


@with_settings
def vector_env(
    mission: str | Path | Scenario = "paper",
    *,
    flights: int = 4,
    neighbours: int = 4,
    message: int = 0,
    acceleration: float = 3.0,
    reward: Mapping[str, float] | None = None,
    **keys: Any,
) -> "VectorFlock":
    """A vector environment of Gymnasium for one policy of all UAVs: its rows are flights × UAVs.

    Row f·N + i is UAV i of flight f. Flights have seeds of their own. A flight that has ended begins anew in the next
    step, in which the actions of its rows have no effect.

    Args:
        flights: number of flights. The others are as for `parallel_env`.

    Raises:
        BadInput: an argument cannot be used, or the extra `rl` is not installed.
    """
    with available("meanflock.env.vector_env", "rl"):
        from meanflock.env.episode import Form
        from meanflock.env.vector import VectorFlock
    return VectorFlock(Form(mission, neighbours, message, acceleration, reward, keys), flights)


class Policy:
    """A saved policy.

    path: the file. sha256: hash of the file. neighbours, message: those of the environment that it needs.
    dimensions: 2 or 3. keys: the arguments with which `mf.fly` flies it: `mf.fly("paper", **policy.keys)`.
    """

    def __init__(self, path: str | Path) -> None:
        network, self.sha256 = read(path)
        self.path = paths.given(path)
        self._network = network
        self.neighbours = network.neighbours
        self.message = network.message
        self.dimensions = network.axes
        self.keys: dict[str, Any] = {
            "method": "policy",
            "controller": {"file": str(path), "sha256": self.sha256},
        }

    def __call__(self, observations: Floats) -> Vectors:
        """Returns the actions (M, d + W) of observations (M, width); a row's bits do not depend on the others.

        Raises:
            BadInput: the observations have another shape or dtype.
        """
        try:
            rows = as_floats("observations", observations, (*np.shape(observations)[:1], len(self._network.scale)))
        except (TypeError, ValueError) as error:
            raise BadInput(f"policy: {error}") from error
        acceleration, messages = self._network(rows)
        return acceleration if messages is None else np.concatenate([acceleration, messages], axis=1)


def policy(file: str | Path) -> Policy:
    """Opens a saved policy.

    Raises:
        BadInput: the file cannot be read, or is no policy of this version.
    """
    return Policy(file)


def save_policy(
    file: str | Path,
    layers: Any,
    *,
    neighbours: int,
    message: int = 0,
    acceleration: float = 3.0,
    scale: Any = None,
) -> Policy:
    """Saves a network as a policy, and opens it.

    Its action is `acceleration * tanh(…)`, of layers with tanh between them.

    Args:
        file: the file, which ends in .npz.
        layers: pairs of weights (inputs, outputs) and biases (outputs,). The last has 2 + `message` outputs in the
            plane, 3 + `message` in space.
        neighbours: K of the environment. message: W of the environment.
        acceleration: largest acceleration along an axis, m/s².
        scale: the observation is divided by these numbers; None: by 1.

    Raises:
        BadInput: the arrays do not fit each other, or no file can be made there.
    """
    observed, numbers = (
        count_of("neighbours:", neighbours, 1, MAX_NEIGHBOURS),
        count_of("message:", message, 0, MAX_MESSAGE),
    )
    try:
        pairs = tuple(
            (as_floats("weights", weights, np.shape(weights)), as_floats("biases", biases, np.shape(biases)))
            for weights, biases in layers
        )
        divisor = (
            np.ones(np.shape(pairs[0][0])[:1] if pairs else ())
            if scale is None
            else as_floats("scale", scale, np.shape(scale))
        )
        limit = float(acceleration)
    except (TypeError, ValueError) as error:
        raise BadInput(f"policy: {error}; give pairs of arrays, and numbers") from error
    return Policy(_save(file, Network(observed, numbers, limit, divisor, pairs)))
