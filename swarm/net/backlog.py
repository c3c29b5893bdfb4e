"""What came in and waits to be received: a queue in which no sender may have more than its share."""

import queue
import threading

from meanflock.swarm.net.bus import Delivery, Quota, Quotas
from meanflock.swarm.net.refusals import Refusals

BATCH_BYTES = 2**16  # may wait of any sender, however short its messages have to be
LARGEST = 4  # so many messages as long as they may be, of a sender
_MESSAGES = 256  # of a sender: an honest node has two or three under way


class Backlog:
    """Deliveries in the order in which they came, from any thread."""

    def __init__(self, quotas: Quotas | None, refusals: Refusals | None) -> None:
        """`quotas`: whose a message is, and how long it may be; None where nothing is counted. `refusals`: where what
        does not fit any more is."""
        self._queue: queue.SimpleQueue[tuple[Delivery, str]] = queue.SimpleQueue()  # and whose, where that counts
        self._quotas, self._refusals = quotas, refusals
        self._waiting: dict[str, tuple[int, int]] = {}  # messages and their bytes, by sender
        self._counting = threading.Lock()

    def quota(self, key: str) -> Quota | None:
        """What the sender of messages under a key may have waiting."""
        return None if self._quotas is None else self._quotas(key)

    def keep(self, delivery: Delivery, quota: Quota | None) -> None:
        """Lets a delivery wait, if there is room for it."""
        if self.has_room(delivery.key, len(delivery.payload), quota):
            self.put(delivery, quota)

    def put(self, delivery: Delivery, quota: Quota | None) -> None:
        """Lets a delivery wait that was counted in."""
        self._queue.put((delivery, "" if quota is None else quota.owner))

    def has_room(self, key: str, more: int, quota: Quota | None) -> bool:
        """Whether one more message of that many bytes may wait; then it is counted in."""
        if quota is None:
            return True
        with self._counting:
            count, size = self._waiting.get(quota.owner, (0, 0))
            most = max(BATCH_BYTES, LARGEST * quota.largest)
            if fits := count < _MESSAGES and size + more <= most:
                self._waiting[quota.owner] = (count + 1, size + more)
        if not fits and self._refusals is not None:
            self._refusals.count("backlog", key)
        return fits

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
