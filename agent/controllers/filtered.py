"""Base class of filters. A filter changes the accelerations of any controller before the vehicle gets them.

Every UAV broadcasts its state for the filter according to `[sharing]`, and in every tick the filter decides the
accelerations. The controller's model, reports, diagnostics and broadcasts pass unchanged. The filter's broadcast is the
first of a tick, so the numbers of the controller's broadcasts are raised by one on the air, and lowered again before
the controller gets them. Arrays of the filter's memory have names that begin with `filter_`.
"""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.agent.controllers.base import Arrival, Controller, Memory, Options, Received, Rows, Step
from meanflock.agent.controllers.sharing.base import NeighbourStates
from meanflock.swarm import state
from meanflock.swarm.declared import column_names
from meanflock.swarm.errors import FAILURES, last_line
from meanflock.swarm.plugins.guard import check_values
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats, Mask, States, Vectors, distinct

PREFIX = "filter_"  # of the filter's memory, and of columns whose names a controller may have too
_UNSENT = "unsent"  # the last of its columns
_OWN = 0  # the number of the filter's broadcast


class Filter:
    """Base class of filters: override `admit`; declare its options and the diagnostics that it reports."""

    plugin_kind: ClassVar[Literal["filter"]] = "filter"
    name: ClassVar[str] = ""  # value of `filter.kind`
    dimensions: ClassVar[tuple[int, ...]] = (2,)  # numbers of axes d in which it flies
    Options: ClassVar[type[msgspec.Struct]] = Options
    columns: tuple[str, ...] = ()  # diagnostics of the filter, after those of the controller and before `unsent`

    def __init__(self, options: Any, scenario: Scenario, inner: Controller) -> None:
        """`options`: an instance of `Options`. `inner`: the controller whose accelerations it filters."""
        self.options = options
        self.scenario = scenario
        self.inner = inner
        self.parameters = inner.parameters
        self.parts = inner.parts
        self.weights = inner.weights
        self.period_ticks = inner.period_ticks
        self.weighted = inner.weighted
        self.note_bytes = inner.note_bytes
        self.dated = inner.dated
        self.busy, self.measured = inner.busy, inner.measured
        self.recorded = dict(inner.recorded)
        self.guided = inner.guided
        own = column_names(f"filter {self.name!r}: `columns`", self.columns, (_UNSENT,))
        inner_names = tuple(inner.diagnostics)
        # Columns of several controllers lie side by side.
        has_several = len({group.method for group in scenario.groups}) > 1
        own_names = tuple(PREFIX + name if has_several or name in inner_names else name for name in (*own, _UNSENT))
        self.diagnostics = (*inner_names, *own_names)
        self.broadcast_numbers = inner.broadcast_numbers + scenario.state_numbers
        self.pairwise = True  # it knows a state of every other UAV
        self.shares = True
        self._neighbours = NeighbourStates(scenario, inner.prediction(), all_share=True)

    @abstractmethod
    def admit(self, own: States, others: States, uavs: NDArray[np.integer], wanted: Vectors) -> tuple[Vectors, Floats]:
        """Returns the accelerations that the rows fly, and the diagnostics of the filter.

        Args:
            own: (M, 2d) the states of the rows. others: (M, N, 2d) each row's estimates of all UAVs' states; its own is
                the one that it sent last. uavs: (M,) the numbers of the rows. wanted: (M, d) m/s², the controller's
                command.

        Returns:
            (M, d) m/s², and (M, len(columns)). Leave rows non-finite whose `wanted` is not finite.
        """
        raise NotImplementedError

    def init(self, uavs: NDArray[np.intp], plan: States) -> Memory:
        """See `Controller.init`."""
        inner_memory = self.inner.init(uavs, plan)
        if taken := sorted(name for name in inner_memory if name.startswith(PREFIX)):
            raise ValueError(f"memory[{taken[0]!r}]: names that begin with {PREFIX!r} are those of the filter")
        return inner_memory | _prefixed(self._neighbours.init(uavs, plan))

    def step(self, memory: Memory, tick: int, own: States, received: Sequence[Received]) -> Step:
        """See `Controller.step`."""
        inner_memory, own_memory = _split(memory)
        step = self.inner.step(inner_memory, tick, own.copy(), of_inner(received))
        wanted = step.acceleration
        if np.shape(wanted) != (shape := (len(own), state.axes(own))):
            raise ValueError(f"acceleration has shape {np.shape(wanted)}; expected {shape}")
        own_memory, refused = self._neighbours.receive(own_memory, tick, received, _OWN)
        others = self._neighbours.states(own_memory, tick)
        acceleration, reported = self._admitted(own, others, own_memory["neighbour_uav"], wanted)
        own_memory, broadcast = self._neighbours.broadcast_states(own_memory, tick, own)
        inner_reported = () if step.diagnostics is None else (step.diagnostics,)
        return Step(
            step.memory | _prefixed(own_memory),
            acceleration,
            np.concatenate([*inner_reported, reported, self._neighbours.unsent(own_memory)], axis=1),
            (broadcast, *step.broadcasts),
            step.refused if not len(refused) else distinct(np.concatenate([step.refused, refused])).astype(np.int32),
            step.news,
        )

    def _admitted(
        self, own: States, others: States, uavs: NDArray[np.integer], wanted: Vectors
    ) -> tuple[Vectors, Floats]:
        """The result of `admit`, checked. Errors name the filter, not the controller."""
        try:
            answer = self.admit(own, others, uavs, wanted)
            acceleration, reported = check_values("admit", answer, 2, "the accelerations and the columns")
        except FAILURES as error:
            raise RuntimeError(f"filter {self.name!r}: {last_line(error)}") from error
        for part, table, shape in (
            ("accelerations", acceleration, (len(own), state.axes(own))),
            ("columns", reported, (len(own), len(self.columns))),
        ):
            if np.shape(table) != shape:
                raise ValueError(f"filter {self.name!r}: `admit` returns {part} {np.shape(table)}; expected {shape}")
        return acceleration, reported

    def get(self, memory: Memory) -> Floats:
        """See `Controller.get`."""
        return self.inner.get(_split(memory)[0])

    def set(self, memory: Memory, rows: Rows, models: Floats) -> Memory:
        """See `Controller.set`."""
        inner_memory, own_memory = _split(memory)
        return self.inner.set(inner_memory, rows, models) | _prefixed(own_memory)

    def guide(self, memory: Memory, rows: Rows, goals: Floats) -> Memory:
        """See `Controller.guide`."""
        inner_memory, own_memory = _split(memory)
        return self.inner.guide(inner_memory, rows, goals) | _prefixed(own_memory)

    def arrived(self, memory: Memory, rows: Rows, arrival: Arrival) -> Memory:
        """See `Controller.arrived`."""
        inner_memory, own_memory = _split(memory)
        return self.inner.arrived(inner_memory, rows, arrival) | _prefixed(own_memory)

    def ready(self, memory: Memory) -> Mask:
        """See `Controller.ready`."""
        return self.inner.ready(_split(memory)[0])

    def based(self, memory: Memory) -> NDArray[np.integer] | None:
        """See `Controller.based`."""
        return self.inner.based(_split(memory)[0])

    def note(self, memory: Memory) -> Sequence[bytes]:
        """See `Controller.note`."""
        return self.inner.note(_split(memory)[0])

    def samples(self, memory: Memory) -> Floats:
        """See `Controller.samples`."""
        return self.inner.samples(_split(memory)[0])

    def report(self, memory: Memory) -> Floats:
        """See `Controller.report`."""
        return self.inner.report(_split(memory)[0])


def _prefixed(own_memory: Memory) -> Memory:
    return {PREFIX + name: array for name, array in own_memory.items()}


def _split(memory: Memory) -> tuple[Memory, Memory]:
    """The memories of the controller and of the filter, each with its own names."""
    inner_memory = {name: array for name, array in memory.items() if not name.startswith(PREFIX)}
    own_memory = {name.removeprefix(PREFIX): array for name, array in memory.items() if name.startswith(PREFIX)}
    return inner_memory, own_memory


def of_inner(received: Sequence[Received]) -> tuple[Received, ...]:
    """The frames of the controllers, with the numbers that the controllers gave them."""
    return tuple(
        Received(frames.number - 1, frames.source, frames.payload, frames.links)
        for frames in received
        if frames.number != _OWN
    )
