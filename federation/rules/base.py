"""What every aggregation rule implements: from the models of a round to the global one."""

from abc import abstractmethod
from typing import Any, ClassVar, Literal, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats

State: TypeAlias = dict[str, NDArray[Any]]


class Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The options of a rule that has none; derive from it and add annotated fields with defaults."""


class Aggregator:
    """Base class of aggregation rules; override `step`, and `init` where the rule remembers anything.

    The order of arrival leaves no trace: models come in ascending order of their UAVs.
    """

    door: ClassVar[Literal["aggregator"]] = "aggregator"
    name: ClassVar[str] = ""  # what `federation.aggregation` says
    Options: ClassVar[type[msgspec.Struct]] = Options

    def __init__(self, options: Any, scenario: Scenario) -> None:
        """`options`: of the type `Options`."""
        self.options, self.scenario = options, scenario

    def init(self, parameters: int) -> State:
        """What the rule remembers before the first round; checkpointed, and handed to a leader that takes over. It
        keeps its names, dtypes and shapes: the world is told at take-off how long messages may become.
        """
        return {}

    @abstractmethod
    def step(self, state: State, models: Floats, uavs: NDArray[np.intp], round_: int) -> tuple[State, Floats]:
        """The state after a round, and its global model, (parameters,).

        Args:
            models: (S, parameters), at least one, finite. uavs: (S,) who sent them, ascending. round_: 1, 2, …
        """
        raise NotImplementedError
