"""What every controller implements: from what a UAV senses and receives to what it does and says.

A node holds M UAVs as rows of arrays. A row never sees another row but through `received`: the same UAVs must fly the
same bits in one process as in many. All that a controller remembers is in its memory, a dict of arrays with a leading
axis of rows, which is checkpointed as it is. Randomness comes from `swarm.seeds`, by the number of the UAV.
"""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar, Literal, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.agent.controllers.prediction import Prediction
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Plane, States
from meanflock.swarm.wire.messages import NOBODY

Memory: TypeAlias = dict[str, NDArray[Any]]
Rows: TypeAlias = NDArray[np.intp]


class Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The options of a controller that has none; derive from it and add annotated fields with defaults."""


class Received(msgspec.Struct, frozen=True, eq=False):
    """Frames that the radio brought to some rows in this tick.

    number: which of its sender's broadcasts of the tick it was sent in. source: (S,) the UAVs that sent. payload: (S,
    W), what each sent; floats as float64, though no more precise than the radio's. links: (L, 2), [row of payload,
    row].
    """

    number: int
    source: NDArray[np.intp]
    payload: NDArray[Any]
    links: NDArray[np.intp]


class Broadcast(msgspec.Struct, frozen=True, eq=False):
    """What rows send to every UAV in range, one frame a row.

    payload: (S, W): float64, which travels as a float of the radio, or an array of int8, uint8, int16 or int32, which
    travels as it is. rows: (S,) ascending, who sends; None for all.
    """

    payload: NDArray[Any]
    rows: Rows | None = None


class Step(msgspec.Struct, frozen=True, eq=False):
    """What a tick came to.

    memory: after it. acceleration: (M, 2), m/s². diagnostics: (M, K), in the order in which they are declared.
    broadcasts: what is sent; their order in the tuple is the `number` others receive. refused: UAVs of whom something
    received is not used, counted by the world.
    """

    memory: Memory
    acceleration: Plane
    diagnostics: NDArray[np.float64] | None = None
    broadcasts: Sequence[Broadcast] = ()
    refused: NDArray[np.int32] = NOBODY


class Controller:
    """Base class of controllers: override `step`, and `init` if it remembers anything; declare what is not default."""

    door: ClassVar[Literal["controller"]] = "controller"
    name: ClassVar[str] = ""  # what `method` says
    Options: ClassVar[type[msgspec.Struct]] = Options
    parameters: int = 0  # floats of the model it shares with the federation
    parts: tuple[int, ...] = ()  # sizes of its parts, in order; one part where left out
    weights: int | None = None  # floats of what `report` returns; as many as `parameters` where left out
    diagnostics: tuple[str, ...] = ()
    period_ticks: int = 100  # between two rounds, where `federation.period` is not set
    broadcast_numbers: int = 64  # that a UAV broadcasts in a tick at the most, in all its frames
    pairwise: bool = False  # whether a UAV remembers something of every other: memory then grows with N²

    def __init__(self, options: Any, scenario: Scenario) -> None:
        """`options`: of the type `Options`. Expensive tables are better made in `init`."""
        self.options, self.scenario = options, scenario

    def init(self, uavs: NDArray[np.intp], plan: States) -> Memory:
        """The memory of a node's rows at take-off; by default none.

        Args:
            uavs: (M,) the numbers of its UAVs, ascending. plan: (N, 4) everyone's initial state, known to all.
        """
        return {}

    @abstractmethod
    def step(self, memory: Memory, tick: int, own: States, received: Sequence[Received]) -> Step:
        """One tick. The arrays of `memory` are not written to; those returned are this tick's own.

        Args:
            own: (M, 4) the states of the rows. received: what the radio delivered to them since the last tick.
        """
        raise NotImplementedError

    def get(self, memory: Memory) -> NDArray[np.float64]:
        """The models that are uploaded, (M, parameters)."""
        if self.parameters:
            raise NotImplementedError("a controller that declares `parameters` must override `get`")
        return np.zeros((len(next(iter(memory.values()), ())), 0))

    def set(self, memory: Memory, rows: Rows, models: NDArray[np.float64]) -> Memory:
        """The memory after a global model, (len(rows), parameters), reached some rows."""
        if self.parameters:
            raise NotImplementedError("a controller that declares `parameters` must override `set`")
        return memory

    def prediction(self) -> Prediction | None:
        """How others should carry on a state that one of its UAVs sent; None: at constant velocity."""
        return None

    def report(self, memory: Memory) -> NDArray[np.float64]:
        """What was learned, as it is recorded, (M, weights)."""
        return self.get(memory)
