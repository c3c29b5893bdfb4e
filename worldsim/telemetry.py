"""What the world tells whoever listens: rows of the flight gathered into blocks, kept until they are safe.

The world never waits for a listener. Blocks go out while few are unacknowledged; the rest wait here, bounded, and a
listener that comes back is sent what it missed.
"""

from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock.channel.medium import Medium
from meanflock.swarm.declared import Declared
from meanflock.swarm.state import Floats
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import SWARM_COLUMNS, Event, Finished, FrameKind, Status, Telemetry
from meanflock.worldsim.commands import Commands
from meanflock.worldsim.counters import Counters
from meanflock.worldsim.flight import Flight

MAX_WAITING_BYTES = 64 * 2**20
WINDOW_BLOCKS = 8
STATE_LINKS_EVERY_TICKS = 10  # hjb uses N(N−1) links a tick; all their outages are kept, of the rest a sample

_ARRIVED = bytes([Status.ARRIVED])
_STATE = int(FrameKind.STATE)  # a member of an enumeration is converted anew each time it is compared


class Rows:
    """The rows of the block being filled."""

    def __init__(self, run: int, uavs: int, capacity: int, declared: Declared) -> None:
        self._run, self._capacity, self._declared = run, capacity, declared
        self.block = 0  # the number of the one being filled
        self._columns: dict[str, Any] = {  # as `Telemetry` has them
            "states": np.zeros((capacity, uavs, 4)),
            "accelerations": np.zeros((capacity, uavs, 2), dtype=np.float32),
            "diagnostics": np.zeros((capacity, uavs, len(declared.diagnostics)), dtype=np.float32),
            "status": np.zeros((capacity, uavs), dtype=np.uint8),
            "energy": np.zeros((capacity, uavs), dtype=np.float32),
            "swarm": np.zeros((capacity, len(SWARM_COLUMNS))),
        }
        self._outages = -1.0  # as of the last row; of none yet, so that the first is looked at
        self._clear(0)

    @property
    def full(self) -> bool:
        """Whether the block must be taken before the next row."""
        return self._filled == self._capacity

    def add(
        self,
        flight: Flight,
        air: Medium,
        commands: Commands,
        links: NDArray[np.int32],
        counters: Counters,
    ) -> None:
        """One row: the flight as it is now, with the commands and diagnostics that led here."""
        k, columns = self._filled, self._columns
        columns["states"][k] = flight.states
        columns["accelerations"][k] = commands.accelerations
        columns["diagnostics"][k] = commands.diagnostics
        columns["status"][k] = flight.status
        columns["energy"][k] = flight.energy
        *_, outages, _ = radio = air.meter.figures()
        columns["swarm"][k] = (
            *radio,
            flight.phi_a,
            flight.phi_c,
            flight.phi_c_distinct or 0.0,
            flight.collisions,
            flight.status.tobytes().count(_ARRIVED),
            counters.rounds,
            counters.held,
            counters.deadline_misses,
        )
        if len(links) and flight.tick % STATE_LINKS_EVERY_TICKS:
            links = self._sample(links, outages > self._outages)
        if len(links):
            self._links.append(links)
        self._outages = outages
        self._events += flight.events
        flight.events = []
        self._filled += 1

    def note(self, event: Event) -> None:
        """An event that is not the flight's own."""
        self._events.append(event)

    def report(self, tick: int, leader_model: Floats, spread: float) -> None:
        """What the leader's UAV has learned, (W,), and the spread of all models, as of a tick."""
        self._reports.append((tick, leader_model, spread))

    def resume(self, block: int, first_tick: int) -> None:
        """Of a resumed run: the number of the next block, and the tick of its first row."""
        self.block, self._first_tick = block, first_tick

    def take(self, checkpoint: bytes = b"") -> Telemetry:
        """The block so far, with a checkpoint of its last row if there is one; the next one begins."""
        n = self._filled
        block = Telemetry(
            run=self._run,
            block=self.block,
            first_tick=self._first_tick,
            **{name: column[:n].copy() for name, column in self._columns.items()},
            links=np.concatenate([np.zeros((0, 5), dtype=np.int32), *self._links]),
            report_ticks=np.array([tick for tick, _, _ in self._reports], dtype=np.int32),
            reports=np.array([vector for _, vector, _ in self._reports], dtype=np.float32).reshape(
                len(self._reports), self._declared.weights
            ),
            spread=np.array([spread for _, _, spread in self._reports]),
            events=tuple(self._events),
            checkpoint=checkpoint,
            diagnostic_names=self._declared.diagnostics,
        )
        self.block += 1
        self._clear(self._first_tick + n)
        return block

    def _sample(self, links: NDArray[np.int32], lost: bool) -> NDArray[np.int32]:
        """All but states that got through; `lost`: whether any did not."""
        if links.item(0, 3) == links.item(-1, 3) == _STATE:  # kinds come one after the other
            return links.compress(links[:, 4] < 0, axis=0) if lost else links[:0]
        return links.compress((links[:, 4] < 0) | (links[:, 3] != _STATE), axis=0)

    def _clear(self, first_tick: int) -> None:
        self._first_tick = first_tick
        self._filled = 0
        self._links: list[NDArray[np.int32]] = []
        self._reports: list[tuple[int, Floats, float]] = []
        self._events: list[Event] = []


class Outbox:
    """Encoded blocks on their way to a recording listener."""

    def __init__(self, *, keeps: bool = True) -> None:
        """`keeps`: whether anybody may ever listen; if not, nothing is encoded."""
        self._keeps = keeps
        self.dropped = 0  # blocks given up because too many waited
        self._checkpoint = -1  # the last block that has one
        self._waiting: deque[tuple[int, bytes]] = deque()
        self._bytes = 0
        self._sent_up_to = -1

    def add(self, block: Telemetry | Finished) -> None:
        """Keeps a block until it is acknowledged, or until there are too many."""
        if not self._keeps:
            return
        raw = control.encode(block)
        if isinstance(block, Telemetry) and block.checkpoint:
            self._checkpoint = block.block
        self._waiting.append((block.block, raw))
        self._bytes += len(raw)
        while self._bytes > MAX_WAITING_BYTES:
            self._bytes -= len(self._waiting.popleft()[1])
            self.dropped += 1

    def acknowledge(self, block: int) -> None:
        """Every block up to this one is safe."""
        while self._waiting and self._waiting[0][0] <= block:
            self._bytes -= len(self._waiting.popleft()[1])

    def rewind(self) -> None:
        """A listener is new: it is sent everything that waits."""
        self._sent_up_to = -1

    def next(self) -> list[bytes]:
        """Blocks to send now: in order, at most a window of them unacknowledged."""
        ready = [(n, raw) for n, raw in list(self._waiting)[:WINDOW_BLOCKS] if n > self._sent_up_to]
        if ready:
            self._sent_up_to = ready[-1][0]
        return [raw for _, raw in ready]

    @property
    def holds_checkpoint(self) -> bool:
        """Whether the last checkpoint still waits: another one would only take the room of telemetry."""
        return bool(self._waiting) and self._waiting[0][0] <= self._checkpoint

    @property
    def waiting(self) -> int:
        """How many blocks are not safe yet."""
        return len(self._waiting)

    @property
    def empty(self) -> bool:
        """Whether everything is safe."""
        return not self._waiting
