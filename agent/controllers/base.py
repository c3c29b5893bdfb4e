"""Base class of controllers, and the selection of the received frames that a controller uses.

A node holds M UAVs as rows of arrays. A row sees other rows through `received` only: the same UAVs must fly the same
bits in one process and in many. The memory of a controller is a dict of arrays with a leading axis of rows; checkpoints
store it. Random numbers come from `swarm.seeds`, by the number of the UAV.
"""

from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial, reduce
from types import MappingProxyType
from typing import Any, ClassVar, Literal, Protocol, TypeAlias

import msgspec
import numpy as np
from numpy.typing import DTypeLike, NDArray

from meanflock.swarm import state
from meanflock.swarm.events.nodes import Problem
from meanflock.swarm.mission import starts
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats, Mask, States, Vectors, distinct
from meanflock.swarm.wire.messages import NOBODY

Memory: TypeAlias = dict[str, NDArray[Any]]
Rows: TypeAlias = NDArray[np.intp]
Which: TypeAlias = Any  # an index of UAVs into (N, …): a slice, or an array of numbers


class Prediction(Protocol):
    """Rule that predicts the state of another UAV from the last one it sent. Rows do not depend on each other."""

    def keep(self, states: States, uavs: NDArray[np.intp], tick: int) -> Floats:
        """Returns the numbers to remember, (S, 2d), of states (S, 2d) that UAVs (S,) sent in a tick."""

    def now(self, remembered: Floats, age: NDArray[np.int32], uavs: Which, tick: int) -> Floats:
        """Returns the states predicted for a tick, (M, 2d, K), from numbers of `keep`, (M, 2d, K), `age` (M, K) ticks
        old.

        `uavs`: index of the UAVs; it selects (K, 2d) or (M, K, 2d) from an array (N, 2d).
        """


class Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base class of a controller's options: derive from it and add annotated fields with defaults."""


class Received(msgspec.Struct, frozen=True, eq=False):
    """Frames that the radio delivered to some rows in this tick.

    number: index of the frames among their sender's broadcasts of a tick. source: (S,) the UAVs that sent them.
    payload: (S, W) the numbers they sent; floats are float64 with the precision of the radio's floats. links: (L, 2),
    pairs [row of payload, row that received it].
    """

    number: int
    source: NDArray[np.intp]
    payload: NDArray[Any]
    links: NDArray[np.intp]


class Broadcast(msgspec.Struct, frozen=True, eq=False):
    """Frames that rows send to every UAV in range, one frame for each row.

    payload: (S, W), float64, sent as floats of the radio; or int8, uint8, int16 or int32, sent unchanged. rows: (S,)
    the rows that send, ascending; None: all rows.
    """

    payload: NDArray[Any]
    rows: Rows | None = None


class Step(msgspec.Struct, frozen=True, eq=False):
    """Result of a tick.

    memory: the memory after the tick. acceleration: (M, d), m/s². diagnostics: (M, K), in the declared order.
    broadcasts: the frames to send; a receiver gets their position in the tuple as `number`. refused: UAVs whose
    received states were not used; the world counts them. news: what the events of the run should have: texts, and
    trainings that gave no model.
    """

    memory: Memory
    acceleration: Vectors
    diagnostics: NDArray[np.float64] | None = None
    broadcasts: Sequence[Broadcast] = ()
    refused: NDArray[np.int32] = NOBODY
    news: Sequence[Problem] = ()


class Arrival(msgspec.Struct, frozen=True, eq=False):
    """The global model of a round, as it reached R rows.

    number: the round. models: (R, parameters). whole: (R,) whether all fragments arrived. notes: the leader's note to
    each row; empty if it sends none.
    """

    number: int
    models: NDArray[np.float64]
    whole: Mask
    notes: Sequence[bytes]

    def row(self, place: int) -> "Arrival":
        """The arrival at one of the rows alone."""
        one = slice(place, place + 1)
        return Arrival(self.number, self.models[one], self.whole[one], self.notes[one])


class Controller:
    """Base class of controllers: override `step`, and `init` if it has a memory; declare what differs from these."""

    plugin_kind: ClassVar[Literal["controller"]] = "controller"
    name: ClassVar[str] = ""  # value of `method`
    dimensions: ClassVar[tuple[int, ...]] = (2,)  # numbers of axes d in which it flies
    Options: ClassVar[type[msgspec.Struct]] = Options
    parameters: int = 0  # floats of the model it shares with the federation
    parts: tuple[int, ...] = ()  # block sizes of the model; int8 scales each block separately
    weights: int | None = None  # number of learned floats of a UAV, which `report` returns; None: `parameters`
    diagnostics: tuple[str, ...] = ()
    period_ticks: int = 100  # ticks between rounds, if `federation.period` is unset
    broadcast_numbers: int = 64  # limit of the numbers that a UAV broadcasts in a tick, all frames together
    pairwise: bool = False  # whether a UAV has memory for each other UAV; memory grows with N²
    shares: bool = False  # whether UAVs broadcast their states according to `scenario.sharing`
    guided: bool = False  # whether `guide` changes goals in flight
    recorded: Mapping[str, Any] = MappingProxyType({})  # options that a resolved scenario has too: hashes of files
    weighted: bool = False  # whether each model is sent with the number that `samples` returns, 32 bits more
    note_bytes: int = 0  # most bytes of a note that is sent with a model, 48 bits more
    dated: bool = False  # whether each model is sent with the round that `based` returns, in the same 48 bits
    busy: str = ""  # diagnostic that is 1 while a row trains, else 0; empty if none does
    measured: tuple[str, ...] = ()  # diagnostics of trainings, which a row has while the last of them is above 0

    def __init__(self, options: Any, scenario: Scenario) -> None:
        """`options`: an instance of `Options`. Compute expensive tables in `init`."""
        self.options, self.scenario = options, scenario

    def init(self, uavs: NDArray[np.intp], plan: States) -> Memory:
        """Returns the memory of a node's rows at take-off; none by default.

        Args:
            uavs: (M,) the numbers of the node's UAVs, ascending. plan: (N, 2d) the initial states of all UAVs.
        """
        return {}

    @abstractmethod
    def step(self, memory: Memory, tick: int, own: States, received: Sequence[Received]) -> Step:
        """Computes one tick. It must not write to the arrays of `memory`, and returns new ones.

        Args:
            own: (M, 2d) the states of the rows. received: the frames that the radio delivered to them since the last
                tick.
        """
        raise NotImplementedError

    def guide(self, memory: Memory, rows: Rows, goals: NDArray[np.float64]) -> Memory:
        """Returns the memory after some rows were given other goals, (len(rows), d) m.

        Called only if the controller is `guided`, in flights with waypoints or batteries, see `Scenario.is_guided`.
        """
        raise NotImplementedError("a controller that is `guided` must override `guide`")

    def get(self, memory: Memory) -> NDArray[np.float64]:
        """Returns the models to upload, (M, parameters)."""
        if self.parameters:
            raise NotImplementedError("a controller that declares `parameters` must override `get`")
        return np.zeros((len(next(iter(memory.values()), ())), 0))

    def set(self, memory: Memory, rows: Rows, models: NDArray[np.float64]) -> Memory:
        """Returns the memory after the global model, as `models` (len(rows), parameters), has reached some rows."""
        if self.parameters:
            raise NotImplementedError("a controller that declares `parameters` must override `set`")
        return memory

    def arrived(self, memory: Memory, rows: Rows, arrival: Arrival) -> Memory:
        """Returns the memory after a global model has reached some rows. Override it instead of `set` to use the round,
        the note or the missing fragments."""
        return self.set(memory, rows, arrival.models)

    def ready(self, memory: Memory) -> Mask:
        """Returns the mask (M,) of the rows that have a model to upload; the others send none in this round."""
        return np.ones(len(next(iter(memory.values()))), dtype=bool)

    def based(self, memory: Memory) -> NDArray[np.integer] | None:
        """Returns the round (M,) of the global model from which the training of each model began, 0 for the model at
        take-off; None: the round before that of the upload."""
        return None

    def note(self, memory: Memory) -> Sequence[bytes]:
        """Returns the note that is sent with the model of each row, at most `note_bytes` long."""
        return [b""] * len(next(iter(memory.values())))

    def samples(self, memory: Memory) -> NDArray[np.float64]:
        """Returns how much each model counts in a mean, (M,), greater than 0 as float32: for example its number of
        training samples. Called only if the controller is `weighted`."""
        return np.ones(len(next(iter(memory.values()))))

    def prediction(self) -> Prediction | None:
        """Returns the rule by which receivers predict a UAV's state from the last one sent; None: constant velocity."""
        return None

    def report(self, memory: Memory) -> NDArray[np.float64]:
        """Returns all learned floats of each UAV for the recording, (M, weights); by default the model of `get`."""
        return self.get(memory)


def replaced(table: NDArray[Any], rows: Rows, values: Any) -> NDArray[Any]:
    """A copy of a table, with other values in some rows."""
    after = table.copy()
    after[rows] = values
    return after


def of_kind(
    received: Sequence[Received], numbers: int, dtype: DTypeLike = np.float64, number: int = 0
) -> list[Received]:
    """Frames with `numbers` columns of `dtype` that were sent as broadcast `number` of a tick."""
    return [
        frames
        for frames in received
        if frames.number == number and frames.payload.shape[1] == numbers and frames.payload.dtype == dtype
    ]


def believed(
    received: Iterable[Received], possible: Callable[[Floats], Mask]
) -> tuple[list[Received], NDArray[np.int32]]:
    """Frames without the links of payloads that are not `possible`; and the senders of these, for `Step.refused`."""
    taken, refused = [], []
    for frames in received:
        good = possible(frames.payload)
        if not good.all():
            refused.append(frames.source[~good])
            links = frames.links[good[frames.links[:, 0]]]
            frames = Received(frames.number, frames.source, frames.payload, links)
        taken.append(frames)
    return taken, distinct(np.concatenate(refused)).astype(np.int32) if refused else NOBODY


def plausible(scenario: Scenario) -> Callable[[Floats], Mask]:
    """Make a function from states (S, 2d) to a mask (S,) of those that a UAV can have.

    No UAV is faster than `radio.plausible_speed`, nor farther from the origin than any can have come from its start at
    that speed.
    """
    speed = scenario.radio.plausible_speed
    farthest = float(reduce(np.hypot, state.parts(state.position(starts(scenario)))).max())
    return partial(_can_be, farthest + speed * scenario.duration, speed)


def _can_be(reach: float, speed: float, states: Floats) -> Mask:
    numbers = states.astype(np.float64, copy=False)  # the square of an integer may overflow
    position, velocity = state.squared_halves(numbers)
    possible: Mask = (position <= reach * reach) & (velocity <= speed * speed)
    return possible
