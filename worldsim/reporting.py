"""Telemetry: the rows of a flight in blocks, with checkpoints in parts."""

from collections import deque
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from meanflock.swarm.events import FlightEvent, NoCheckpoint
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats
from meanflock.swarm.wire.messages import FrameKind, LinkColumn, Telemetry, has_or_none
from meanflock.worldsim.checkpoint import most_bytes, split
from meanflock.worldsim.clocks import Stopwatch
from meanflock.worldsim.tick import Row
from meanflock.worldsim.world import World

STATE_LINKS_EVERY_TICKS = 10  # hjb uses N(N−1) links a tick: telemetry has all their outages, and a sample of the rest

BLOCK_ROWS = 50  # rows of a block at most

_BLOCK_ROWS = 20  # rows of a block of telemetry at least, of a swarm that is not too large for it
_BLOCK_BYTES = 16 * 2**20  # no block has more rows than fit, so that a few blocks may wait
_BLOCK_STATES = 2500  # a block has more rows as long as it has fewer states than this
_BLOCK_ROWS_REALTIME = 2
_STATE = int(FrameKind.STATE)  # comparing with the member of the enumeration converts it each time


class Mailer(Protocol):
    """Takes the blocks of a flight."""

    def add(self, block: Telemetry) -> None:
        """Take the next block."""

    def publish(self) -> None:
        """Send what may be sent now; called after each tick."""

    @property
    def has_room(self) -> bool:
        """Returns whether a part of a checkpoint may follow."""

    @property
    def holds_checkpoint(self) -> bool:
        """Returns whether the last checkpoint still waits. Another one would displace telemetry."""


class BlockSink(Protocol):
    """Output that stores or shows telemetry."""

    def write(self, block: Telemetry) -> None:
        """Take the next block; blocks come in order, each once."""


class Direct:
    """Hands blocks to sinks in this process."""

    has_room, holds_checkpoint = True, False

    def __init__(self, sinks: Sequence[BlockSink]) -> None:
        self._sinks = sinks

    def add(self, block: Telemetry) -> None:
        """Hand over a block."""
        for sink in self._sinks:
            sink.write(block)

    def publish(self) -> None:
        """Nothing waits."""


class Blocks:
    """Sink that gathers the rows of a flight into blocks of telemetry, and puts checkpoints into them.

    Attributes:
        block: number of the block that is being filled.
    """

    def __init__(
        self, world: World, mailer: Mailer, watch: Stopwatch, *, block_rows: int | None = BLOCK_ROWS, block: int = 0
    ) -> None:
        """
        Args:
            world: whose sums the blocks have.
            mailer: takes the blocks.
            watch: the time flown, which checkpoints have.
            block_rows: most rows of a block; None in real time.
            block: number of the first block; 0 for a flight that begins, whose first row is that of tick 0.
        """
        scenario, self._declared, self._names = world.scenario, world.plan.declared, world.plan.columns
        self._has = np.True_ if (has := world.plan.has_column) is None else has
        self._measured = [self._names.index(name) for name in self._declared.measured]
        uavs = scenario.uavs
        self._world = world
        self._mailer = mailer
        self._watch = watch
        self._parts: deque[bytes] = deque()  # of a checkpoint, that are not in a block yet
        self._has_part = False  # whether the block is to carry one of them
        rows = _BLOCK_ROWS_REALTIME
        if block_rows is not None:
            rows = max(_BLOCK_ROWS, min(block_rows, _BLOCK_STATES // uavs))
        rows = self._rows = max(
            1, min(rows, _BLOCK_BYTES // (uavs * _row_bytes(scenario, len(self._names), bool(self._measured))))
        )
        self._columns: dict[str, Any] = {  # as `Telemetry` has them
            "states": np.zeros((rows, uavs, scenario.state_numbers)),
            "accelerations": np.zeros((rows, uavs, scenario.dimensions), dtype=np.float32),
            "diagnostics": np.zeros((rows, uavs, len(self._names)), dtype=np.float32),
            "status": np.zeros((rows, uavs), dtype=np.uint8),
        }
        self._outages = -1.0  # at the last row; below any count, so that the first row is looked at
        world.flight.books.keep_energies(with_first=block == 0)
        self._begin(block, world.tick + (block > 0))
        if block == 0:
            self.write(world.begun())

    def write(self, row: Row) -> None:
        """Add a row. Before it a block goes out that is full, or has a part of a checkpoint; until then it takes the
        events of the flight's end."""
        if self._filled == self._rows or self._has_part:
            self._flush()
        self._mailer.publish()
        k = self._filled
        world, columns = self._world, self._columns
        flight, counters = world.flight, world.counters
        columns["states"][k] = row.states
        columns["accelerations"][k] = row.accelerations
        columns["diagnostics"][k] = row.diagnostics
        columns["status"][k] = row.status
        *_, outages, _ = radio = world.air.meter.figures()
        self._swarm.append(
            (
                *radio,
                flight.phi_a,
                flight.phi_c,
                flight.phi_c_distinct or 0.0,
                flight.collisions,
                int(np.count_nonzero(flight.arrival_tick >= 0)),
                world.ledger.rounds,
                counters.held,
                counters.deadline_misses,
            )
        )
        links = row.links
        if len(links) and row.tick % STATE_LINKS_EVERY_TICKS:
            links = _sample(links, outages > self._outages)
        if len(links):
            self._links.append(links)
        self._outages = outages
        self._events += row.events
        if row.weights is not None:
            self._reports.append((row.tick - 1, *row.weights))
        self._filled += 1
        is_free = not (self._parts or self._mailer.holds_checkpoint or world.over)
        if row.memories is not None and is_free:
            body = world.checkpoint(row.memories, self._watch.seconds, self.block)
            if len(body) <= (most := most_bytes(world.scenario.uavs)):
                self._parts = deque(split(body))
                self._has_part = True  # it continues from this row
            else:
                reason = f"its {len(body) / 2**20:,.1f} MiB do not fit into {most / 2**20:,.1f} MiB"
                world.note_once(NoCheckpoint(row.tick, reason))
        elif self._parts and self._mailer.has_room and not world.over:
            self._has_part = True

    @property
    def filled(self) -> Floats:
        """The states of the rows that are in no block yet, (rows, N, 4)."""
        states: Floats = self._columns["states"][: self._filled]
        return states

    def finish(self) -> int:
        """End the last block with the rows it has, and the events since; returns the number of the block after it.

        No flight goes on from behind the events of its end.
        """
        if since := self._world.flight.events:
            self._parts.clear()
        self._events += since
        self._flush()
        return self.block

    def _has_diagnostic(self, diagnostics: NDArray[np.float32]) -> NDArray[np.uint8] | None:
        """The diagnostics (T, N, K) that UAVs have: those of trainings once the last training gave all metrics."""
        if not self._measured:
            return has_or_none(np.broadcast_to(self._has, diagnostics.shape[1:])[None])
        has = np.broadcast_to(self._has, diagnostics.shape).copy()
        has[..., self._measured] &= diagnostics[..., self._measured[-1:]] > 0.0
        return has_or_none(has)

    def _begin(self, block: int, first_tick: int) -> None:
        """Begin an empty block of that number, whose first row is that of a tick."""
        self.block = block
        self._first_tick = first_tick
        self._filled = 0
        self._has_part = False
        self._swarm: list[tuple[float, ...]] = []
        self._events: list[FlightEvent] = []
        self._links: list[NDArray[np.int32]] = []
        self._reports: list[tuple[int, Floats, float]] = []

    def _flush(self) -> None:
        """End the block, with the next part of a checkpoint if there is one. Others follow after the next ticks."""
        if not (n := self._filled):
            return
        ticks, reports, spread = zip(*self._reports, strict=True) if self._reports else ((), (), ())
        self._mailer.add(
            Telemetry(
                run=0,
                block=self.block,
                first_tick=self._first_tick,
                **{name: column[:n].copy() for name, column in self._columns.items()},
                swarm=np.array(self._swarm),
                energy=self._world.flight.books.take_energies(n).astype(np.float32),
                links=np.concatenate([np.zeros((0, len(LinkColumn)), dtype=np.int32), *self._links]),
                report_ticks=np.array(ticks, dtype=np.int32),
                reports=np.array(reports, dtype=np.float32).reshape(len(reports), self._declared.weights),
                spread=np.array(spread),
                events=tuple(self._events),
                checkpoint=self._parts.popleft() if self._parts else b"",
                diagnostic_names=self._names,
                has_diagnostic=self._has_diagnostic(self._columns["diagnostics"][:n]),
            )
        )
        self._begin(self.block + 1, self._first_tick + n)


def _row_bytes(scenario: Scenario, diagnostics: int, has_trainings: bool) -> int:
    """Bytes of a UAV's row: states, and in single precision acceleration, diagnostics and energy; status, and with
    trainings which diagnostics the UAV has.
    """
    return 8 * scenario.state_numbers + 4 * (scenario.dimensions + diagnostics + 1) + 1 + has_trainings * diagnostics


def _sample(links: NDArray[np.int32], lost: bool) -> NDArray[np.int32]:
    """The links without delivered states. `lost`: whether any state was lost."""
    first, last = links[[0, -1], LinkColumn.KIND].tolist()
    if first == last == _STATE:  # links are sorted by kind, so all carry states
        return links.compress(links[:, LinkColumn.DELIVERED] == 0, axis=0) if lost else links[:0]
    return links.compress((links[:, LinkColumn.DELIVERED] == 0) | (links[:, LinkColumn.KIND] != _STATE), axis=0)
