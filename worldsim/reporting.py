"""Reports of a run to the ground stations: blocks of telemetry and the summary, kept until they are acknowledged.

The world never waits for a ground station. It sends blocks while few are unacknowledged and keeps the rest, bounded; a
station that comes back gets what it missed.
"""

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from itertools import islice
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.channel.medium import Medium
from meanflock.federation.post import Post
from meanflock.swarm import state
from meanflock.swarm.net import keys
from meanflock.swarm.net.bus import Bus
from meanflock.swarm.state import BEYOND_SENSE, Floats
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import SWARM_COLUMNS, Act, Event, Finished, FrameKind, Status, Telemetry
from meanflock.worldsim.barrier import Commands
from meanflock.worldsim.flight import Flight
from meanflock.worldsim.members import Member
from meanflock.worldsim.summary import Counters, weight_spread

STATE_LINKS_EVERY_TICKS = 10  # hjb uses N(N−1) links a tick: telemetry has all their outages, and a sample of the rest

MAX_WAITING_BYTES = 64 * 2**20
WINDOW_BLOCKS = 8

_BLOCK_ROWS = 20  # rows of a block of telemetry at least, of a swarm that is not too large for it
_BLOCK_BYTES = 16 * 2**20  # no block has more rows than fit, so that a few blocks may wait
_BLOCK_STATES = 2500  # a block has more rows as long as it has fewer states than this
_BLOCK_ROWS_REALTIME = 2
_ARRIVED = bytes([Status.ARRIVED])
_STATE = int(FrameKind.STATE)  # comparing with the member of the enumeration converts it each time


class Outbox:
    """Encoded blocks on their way to a ground station.

    enabled: whether a station may ever listen; if not, nothing is added.
    dropped: blocks given up because too many waited.
    """

    def __init__(self, *, enabled: bool = True) -> None:
        self.enabled = enabled
        self.dropped = 0
        self._checkpoint = -1  # the last block that contains a checkpoint
        self._waiting: deque[tuple[int, bytes]] = deque()
        self._bytes = 0
        self._sent_up_to = -1

    def add(self, block: Telemetry | Finished) -> bytes:
        """Keep a block until it is acknowledged; drop the oldest ones beyond the limit. Returns its bytes."""
        raw = control.encode(block)
        if isinstance(block, Telemetry) and block.checkpoint:
            self._checkpoint = block.block
        self._waiting.append((block.block, raw))
        self._bytes += len(raw)
        while self._bytes > MAX_WAITING_BYTES:
            self._bytes -= len(self._waiting.popleft()[1])
            self.dropped += 1
        return raw

    def acknowledge(self, block: int) -> None:
        """Forget every block up to this one: the station has them."""
        while self._waiting and self._waiting[0][0] <= block:
            self._bytes -= len(self._waiting.popleft()[1])

    def rewind(self) -> None:
        """Send all waiting blocks again: a station is new."""
        self._sent_up_to = -1

    def next(self) -> list[bytes]:
        """The blocks to send now, in order; at most `WINDOW_BLOCKS` are unacknowledged."""
        ready = [(n, raw) for n, raw in islice(self._waiting, WINDOW_BLOCKS) if n > self._sent_up_to]
        if ready:
            self._sent_up_to = ready[-1][0]
        return [raw for _, raw in ready]

    @property
    def has_room(self) -> bool:
        """Returns whether the waiting blocks leave room for a part of a checkpoint without displacing telemetry."""
        return self._bytes < MAX_WAITING_BYTES // 4

    @property
    def holds_checkpoint(self) -> bool:
        """Returns whether the last checkpoint still waits. Another one would displace telemetry."""
        return bool(self._waiting) and self._waiting[0][0] <= self._checkpoint

    @property
    def waiting(self) -> int:
        """Number of unacknowledged blocks."""
        return len(self._waiting)


class Reporter:
    """Gathers the telemetry of one run into blocks.

    Attributes:
        block: number of the block that is being filled.
        events: events of that block, without those of the flight in this tick.
        outbox: blocks that are not acknowledged yet.
    """

    def __init__(
        self,
        bus: Bus,
        run: str,
        flight: Flight,
        air: Medium,
        commands: Commands,
        counters: Counters,
        post: Post,
        *,
        block_rows: int | None,
        enabled: bool,
    ) -> None:
        """`block_rows`: most rows of a block; None in real time. `enabled`: whether a station may ever listen."""
        uavs = flight.scenario.uavs
        self._bus = bus
        self._run = run
        self._fingerprint = keys.fingerprint(run)
        self._flight = flight
        self._air = air
        self._commands = commands
        self._counters = counters
        self._post = post
        self._parts: deque[bytes] = deque()  # of a checkpoint, that are not in a block yet
        self._declared = flight.scenario.declared
        rows = _BLOCK_ROWS_REALTIME
        if block_rows is not None:
            rows = max(_BLOCK_ROWS, min(block_rows, _BLOCK_STATES // uavs))
        self._rows = max(1, min(rows, _BLOCK_BYTES // (uavs * _row_bytes(len(self._declared.diagnostics)))))
        rows = self._rows
        self._columns: dict[str, Any] = {  # as `Telemetry` has them
            "states": np.zeros((rows, uavs, state.SIZE)),
            "accelerations": np.zeros((rows, uavs, state.AXES), dtype=np.float32),
            "diagnostics": np.zeros((rows, uavs, len(self._declared.diagnostics)), dtype=np.float32),
            "status": np.zeros((rows, uavs), dtype=np.uint8),
            "swarm": np.zeros((rows, len(SWARM_COLUMNS))),
        }
        self._outages = -1.0  # at the last row; below any count, so that the first row is looked at
        self.outbox = Outbox(enabled=enabled)
        self.begin(0, 0)

    def begin(self, block: int, first_tick: int) -> None:
        """Begin an empty block of that number, whose first row is that of a tick."""
        self.block = block
        self._first_tick = first_tick
        self._filled = 0
        self.events: list[Event] = []
        self._links: list[NDArray[np.int32]] = []
        self._reports: list[tuple[int, Floats, float]] = []

    def _clear(self) -> None:
        """Drop all that a block would have."""
        self.events.clear()
        self._reports.clear()
        self._flight.books.energies.clear()

    def note(self, kind: str, text: str, uavs: Iterable[int] = ()) -> None:
        """Record an event of this tick, which concerns some UAVs."""
        self.events.append(Event(self._flight.tick, kind, text, tuple(uavs)))

    def learned(
        self, tick: int, asked: Mapping[str, Member], acts: Mapping[str, Act], alive: NDArray[np.bool_]
    ) -> None:
        """Report the model of the leader's UAV, and the spread of the models of all UAVs that are `alive` (N,)."""
        if not self._declared.weights:
            return
        found = [(asked[name], act.models) for name, act in acts.items() if act.models is not None]
        if len(found) == 1 and found[0][0].rows == len(alive):  # one node has all, so they need no copy
            models = found[0][1]
        else:
            models = np.full((len(alive), self._declared.weights), np.nan)
            for member, rows in found:
                models[member.place] = rows
        bounded = (models.max(axis=1) < BEYOND_SENSE) & (models.min(axis=1) > -BEYOND_SENSE)  # false for NaN
        if (counted := bounded & alive).any():
            spread = self._counters.spread = weight_spread(models if counted.all() else models[counted])
            leader = self._flight.scenario.federation.leader
            self._reports.append((tick, np.where(bounded[leader], models[leader], 0.0), spread))

    def add(self, links: NDArray[np.int32]) -> None:
        """Add the row of this tick and its `links` (K, 5); a block that is full goes out before.

        If no station can ever listen, there are no rows.
        """
        flight = self._flight
        meter = self._air.meter
        if flight.last_arrival == flight.tick:
            meter.mark()
        events, flight.events = flight.events, []
        if not self.outbox.enabled:
            self._clear()
            return
        if self._filled == self._rows:
            self.flush()
        k = self._filled
        columns = self._columns
        columns["states"][k] = flight.states
        columns["accelerations"][k] = self._commands.flown
        columns["diagnostics"][k] = self._commands.diagnostics
        columns["status"][k] = flight.status
        *_, outages, _ = radio = meter.figures()
        columns["swarm"][k] = (
            *radio,
            flight.phi_a,
            flight.phi_c,
            flight.phi_c_distinct or 0.0,
            flight.collisions,
            flight.status.tobytes().count(_ARRIVED),
            self._post.rounds,
            self._counters.held,
            self._counters.deadline_misses,
        )
        if len(links) and flight.tick % STATE_LINKS_EVERY_TICKS:
            links = _sample(links, outages > self._outages)
        if len(links):
            self._links.append(links)
        self._outages = outages
        self.events += events
        self._filled += 1

    @property
    def holds_checkpoint(self) -> bool:
        """Returns whether a part of the last checkpoint still waits."""
        return bool(self._parts) or self.outbox.holds_checkpoint

    def flush(self, checkpoint: Sequence[bytes] = ()) -> None:
        """End the block with the rows it has, and with the first part of a checkpoint of its last row if one is given.

        The other parts go in the blocks of the next ticks, when the outbox has room for them.
        """
        if checkpoint:
            self._parts = deque(checkpoint)
        n = self._filled
        ticks, reports, spread = zip(*self._reports, strict=True) if self._reports else ((), (), ())
        self._send(
            Telemetry(
                run=self._fingerprint,
                block=self.block,
                first_tick=self._first_tick,
                **{name: column[:n].copy() for name, column in self._columns.items()},
                energy=self._energies(n),
                links=np.concatenate([np.zeros((0, 5), dtype=np.int32), *self._links]),
                report_ticks=np.array(ticks, dtype=np.int32),
                reports=np.array(reports, dtype=np.float32).reshape(len(reports), self._declared.weights),
                spread=np.array(spread),
                events=tuple(self.events),
                checkpoint=self._parts.popleft() if self._parts else b"",
                diagnostic_names=self._declared.diagnostics,
            )
        )
        self.begin(self.block + 1, self._first_tick + n)

    def _energies(self, rows: int) -> NDArray[np.float32]:
        """The energies of so many rows, which are taken from the books, (rows, N)."""
        books = self._flight.books
        books.settle()
        energies = np.concatenate([np.zeros((0, self._flight.scenario.uavs)), *books.energies])
        books.energies[:] = [energies[rows:]]
        return energies[:rows].astype(np.float32)

    def publish(self) -> None:
        """Send the blocks that may be sent now."""
        if self._parts and self._filled and self.outbox.has_room and not self._flight.over:
            self.flush()
        for raw in self.outbox.next():
            self._bus.put(keys.telemetry(self._run), raw)

    def finish(self, record: dict[str, Any]) -> Finished:
        """End the telemetry with its last block, the summary."""
        self._parts.clear()
        self.flush()
        finished = Finished(self._fingerprint, self.block, msgspec.json.encode(record))
        self._send(finished)
        return finished

    def _send(self, block: Telemetry | Finished) -> None:
        """Keep a block for the stations, and tell the observers, who get it once."""
        if self.outbox.enabled:
            self._bus.tell(keys.observed(self._run), self.outbox.add(block))

    def repeat(self, finished: Finished) -> None:
        """Send the summary again, ahead of all unacknowledged blocks."""
        self._bus.put(keys.telemetry(self._run), control.encode(finished))


def _row_bytes(diagnostics: int) -> int:
    """Bytes of a UAV's row: states, and in single precision acceleration, diagnostics and energy; status."""
    return 8 * state.SIZE + 4 * (state.AXES + diagnostics + 1) + 1


def _sample(links: NDArray[np.int32], lost: bool) -> NDArray[np.int32]:
    """The links without delivered states. `lost`: whether any state was lost."""
    if links.item(0, 3) == links.item(-1, 3) == _STATE:  # links are sorted by kind, so all carry states
        return links.compress(links[:, 4] < 0, axis=0) if lost else links[:0]
    return links.compress((links[:, 4] < 0) | (links[:, 3] != _STATE), axis=0)
