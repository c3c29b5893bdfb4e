"""What came in and waits to be received: a queue in which no sender may have more than its share."""

import queue
import threading

from meanflock.swarm.net.bus import Delivery, Quotas
from meanflock.swarm.net.refusals import Refusals

BATCH_BYTES = 2**16  # may wait of any sender, however short its messages have to be
LARGEST = 4  # so many messages as long as they may be, of a sender
_MESSAGES = 256  # of a sender: an honest node has two or three under way


class Backlog:
    """Deliveries in the order in which they came, from any thread."""

    def __init__(self, quotas: Quotas | None, refusals: Refusals) -> None:
        """`quotas`: whose a message is, and how long it may be; None where nothing is counted. `refusals`: where what
        does not fit any more is."""
        self._queue: queue.SimpleQueue[tuple[Delivery, str]] = queue.SimpleQueue()  # and whose, where that counts
        self._quotas, self._refusals = quotas, refusals
        self._waiting: dict[str, tuple[int, int]] = {}  # messages and their bytes, by sender
        self._counting = threading.Lock()

    def keep(self, delivery: Delivery) -> None:
        """Lets a delivery wait, if its sender has room for it."""
        owner = ""
        if self._quotas is not None:
            owner, largest, _ = self._quotas(delivery.key)
            with self._counting:
                count, size = self._waiting.get(owner, (0, 0))
                size += len(delivery.payload)
                if fits := count < _MESSAGES and size <= max(BATCH_BYTES, LARGEST * largest):
                    self._waiting[owner] = (count + 1, size)
            if not fits:
                self._refusals.count("backlog", delivery.key)
                return
        self._queue.put((delivery, owner))

    def receive(self, timeout_s: float) -> Delivery | None:
        """The next one; None where none comes in time."""
        try:
            delivery, owner = self._queue.get(timeout=timeout_s)
        except queue.Empty:
            return None
        if self._quotas is not None:
            with self._counting:
                count, size = self._waiting[owner]
                if count > 1:
                    self._waiting[owner] = (count - 1, size - len(delivery.payload))
                else:
                    del self._waiting[owner]
        return delivery
