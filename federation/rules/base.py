"""Base class of aggregation rules, which compute the global model from the models of a round."""

from abc import abstractmethod
from typing import Any, ClassVar, Literal, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats

State: TypeAlias = dict[str, NDArray[Any]]


class Uploads(msgspec.Struct, frozen=True, eq=False):
    """The models of a round that one node averages.

    models: (S, parameters), finite. uavs: (S,) the UAVs that they are of, ascending. sent: (S,) the rounds in which
    they were sent. round: the number of the round, from 1 on.
    """

    models: Floats
    uavs: NDArray[np.intp]
    sent: NDArray[np.integer]
    round: int


class Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base class of a rule's options: derive from it and add annotated fields with defaults."""


class Aggregator:
    """Base class of aggregation rules; override `step`, and `init` if the rule has a state.

    Models are in ascending order of their UAVs, so the order of arrival has no effect.
    """

    door: ClassVar[Literal["aggregator"]] = "aggregator"
    name: ClassVar[str] = ""  # value of `federation.aggregation`
    Options: ClassVar[type[msgspec.Struct]] = Options

    def __init__(self, options: Any, scenario: Scenario) -> None:
        """`options`: an instance of `Options`."""
        self.options, self.scenario = options, scenario

    def init(self, parameters: int) -> State:
        """Returns the state before the first round. Checkpoints store the state, and a leader that takes over gets it.

        Names, dtypes and shapes must stay the same, because limits of messages are set at take-off. With the topology
        `neighbours` each UAV has a state of its own.
        """
        return {}

    @abstractmethod
    def step(self, state: State, uploads: Uploads) -> tuple[State, Floats | None]:
        """Returns the state after a round, and its global model, (parameters,).

        None in place of the model: the rule waits for more models. The state is kept, and no model is broadcast.

        Args:
            uploads: at least one model.
        """
        raise NotImplementedError

    def weights(self, uploads: Uploads) -> Floats | None:
        """Returns the weight of each model, (S,), greater than 0, if the rule is a weighted mean; else None.

        A weight may depend on its own upload alone. With the topology `neighbours` one call then serves all UAVs of a
        node, in place of a `step` for each; the state is not used.
        """
        return None
