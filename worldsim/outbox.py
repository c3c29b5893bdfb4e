"""What the world tells whoever listens, on its way: blocks of telemetry, kept until they are safe.

The world never waits for a listener. Blocks go out while few are unacknowledged; the rest wait here, bounded, and a
listener that comes back is sent what it missed.
"""

from collections import deque
from itertools import islice

from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import Finished, Telemetry

MAX_WAITING_BYTES = 64 * 2**20
WINDOW_BLOCKS = 8


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
        ready = [(n, raw) for n, raw in islice(self._waiting, WINDOW_BLOCKS) if n > self._sent_up_to]
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
