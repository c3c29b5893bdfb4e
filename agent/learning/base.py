"""Base class of learners. A learner trains the model that the UAVs share; any controller without a model flies them.

A learner is one object for each UAV. `fit` is called in a thread of its own while the UAV flies on, and the trained
model exists after a simulated time. The model is a tree of arrays; `trees.py` says how it becomes floats.
"""

from abc import abstractmethod
from typing import Any, ClassVar, Literal, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.agent.controllers.base import Options
from meanflock.swarm.scenario import Scenario

# A dict or list of arrays, or of further dicts and lists. An array is NumPy's, or one of torch.
Tree: TypeAlias = dict[str, Any] | list[Any]


class Fit(msgspec.Struct, frozen=True, eq=False):
    """What a learner knows when its training begins.

    number: the round that it trains for. based: the round of the global model, 0 at take-off. seed: 63 bits, of the
    scenario's seed, the round and the UAV. time_s: simulated time, s. position: (2,), m. whole: whether all fragments
    of the global model arrived. note: the leader's note, empty if it sends none.
    """

    number: int
    based: int
    seed: int
    time_s: float
    position: NDArray[np.float64]
    whole: bool
    note: bytes


class Trained(msgspec.Struct, frozen=True, eq=False):
    """Result of a training.

    model: a tree with the names, shapes and dtypes of the first one. examples: how much the model counts in a mean,
    greater than 0. metrics: numbers by name; those that the learner declares are recorded. note: sent with the model.
    """

    model: Tree
    examples: float
    metrics: dict[str, float] = {}
    note: bytes = b""


class TrainingFailed(Exception):
    """Raised by `fit`: this training gives no model. The UAV is silent in the round, and an event has the text."""


class Learner:
    """Base class of learners: override `initial` and `fit`; declare what differs from these.

    Options named `metrics`, `state_bytes`, `note_bytes` or `period_ticks` take the place of these declarations.
    """

    plugin_kind: ClassVar[Literal["learner"]] = "learner"
    name: ClassVar[str] = ""  # value of `training.learner`
    Options: ClassVar[type[msgspec.Struct]] = Options
    metrics: tuple[str, ...] = ()  # numbers of `fit` and `evaluate` that are recorded as diagnostics
    state_bytes: int = 0  # most bytes that `state` returns
    note_bytes: int = 0  # most bytes of `Trained.note`, and of the leader's note
    period_ticks: int = 100  # ticks between rounds, if `federation.period` is unset
    trains_again: bool = True  # from its own model, after a period without a newer global one
    runs_programs: bool = False  # whether it may run other programs, as libraries do that ask for the processor
    keeps: tuple[str, ...] = ()  # names of arrays that stay with the UAV, such as "head.*"; see `training.keeps`

    def __init__(self, options: Any, scenario: Scenario, uav: int) -> None:
        """Make the learner of one UAV. `options`: an instance of `Options`."""
        self.options, self.scenario, self.uav = options, scenario, uav

    @classmethod
    @abstractmethod
    def initial(cls, options: Any, scenario: Scenario) -> Tree:
        """Returns the model at take-off, the same for all UAVs. The global random generators are seeded before."""
        raise NotImplementedError

    @classmethod
    def takes_part(cls, options: Any, scenario: Scenario, uav: int, config: Fit) -> bool:
        """Returns whether a UAV trains the global model that it received; it is free for the next one if not.

        It must be cheap, because the flight waits for it. `fit` returns None if only the training shows it.
        """
        return True

    @abstractmethod
    def fit(self, model: Tree, config: Fit) -> Trained | None:
        """Trains a copy of the global model; returns None to take no part in this round.

        The result must depend on the arguments, the state of `load` and the seeded generators only: the random
        generators of Python, NumPy and torch are seeded with `config.seed` before each call.
        """
        raise NotImplementedError

    def evaluate(self, model: Tree, config: Fit) -> dict[str, float]:
        """Returns metrics of the global model, before `fit` trains it. A measurement: it takes no simulated time."""
        return {}

    def state(self) -> bytes:
        """Returns what the learner remembers after a training, such as moments of an optimiser; see `state_bytes`."""
        return b""

    def load(self, raw: bytes) -> None:
        """Takes what `state` returned after the last training, or b"" before the first one."""
