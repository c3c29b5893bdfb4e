"""Base class of aggregation rules, which compute the global model from the models of a round."""

from abc import abstractmethod
from typing import Any, ClassVar, Literal, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats

State: TypeAlias = dict[str, NDArray[Any]]


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

        Names, dtypes and shapes must stay the same, because limits of messages are set at take-off.
        """
        return {}

    @abstractmethod
    def step(self, state: State, models: Floats, uavs: NDArray[np.intp], round_: int) -> tuple[State, Floats]:
        """Returns the state after a round, and its global model, (parameters,).

        Args:
            models: (S, parameters), at least one row, finite. uavs: (S,) the UAVs that sent them, ascending. round_:
                the number of the round, from 1 on.
        """
        raise NotImplementedError
