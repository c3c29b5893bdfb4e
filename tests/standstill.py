"""How long the machine itself stood still: a virtual one does, for seconds, when its neighbours are busy."""

import threading
import time

LOOK_S = 0.05
NOTABLE_S = 0.5  # a barrier waits for 2 s; less than this, and only the tests know


class Standstill(threading.Thread):
    """Looks twenty times a second and adds up by how much it came late, where that is notable."""

    def __init__(self) -> None:
        super().__init__(name="standstill", daemon=True)
        self.total_s = 0.0

    def run(self) -> None:
        last = time.monotonic()
        while True:
            time.sleep(LOOK_S)
            now = time.monotonic()
            self.note(now - last - LOOK_S)
            last = now

    def note(self, late_s: float) -> None:
        if late_s > NOTABLE_S:
            self.total_s += late_s
