"""What came in and waits to be received: a queue in which no sender may have more than its share."""

import logging
import queue
import threading
from collections import Counter

from meanflock.swarm.net.bus import Delivery, Quotas
from meanflock.swarm.printable import printable

log = logging.getLogger("meanflock.bus")

BATCH_BYTES = 2**16  # may wait of any sender, however short its messages have to be
LARGEST = 4  # so many messages as long as they may be, of a sender
_MESSAGES = 256  # of a sender: an honest node has two or three under way


class Backlog:
    """Deliveries in the order in which they came, from any thread."""

    def __init__(self, quotas: Quotas | None) -> None:
        """`quotas`: the sender of a message, and how long it may be; None: no limit."""
        self.dropped: Counter[str] = Counter()  # deliveries beyond the share of their sender: `backlog`
        self._queue: queue.SimpleQueue[tuple[Delivery, str]] = queue.SimpleQueue()  # with the sender, if it is limited
        self._quotas = quotas
        self._waiting: dict[str, tuple[int, int]] = {}  # messages and their bytes, by sender
        self._counting = threading.Lock()

    def keep(self, delivery: Delivery) -> None:
        """Lets a delivery wait, if its sender has room for it."""
        owner = ""
        if self._quotas is not None:
            owner, largest = self._quotas(delivery.key)
            with self._counting:
                count, size = self._waiting.get(owner, (0, 0))
                size += len(delivery.payload)
                if fits := count < _MESSAGES and size <= max(BATCH_BYTES, LARGEST * largest):
                    self._waiting[owner] = (count + 1, size)
                else:
                    self.dropped["backlog"] += 1
                    times = self.dropped["backlog"]
            if not fits:
                if times & (times - 1) == 0:  # a flood does not fill the log
                    where = printable(delivery.key)
                    log.warning("%d messages dropped, too many wait; the last under %s", times, where)
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
