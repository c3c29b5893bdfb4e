"""The processes of this machine that fly a study, joblib's own, ended without noise."""

import queue
from contextlib import suppress

from joblib.parallel import LokyBackend

_FEEDER_S = 5.0


class Pool(LokyBackend):
    """joblib's processes of this machine, whose threads end in order when the processes are killed."""

    def abort_everything(self, ensure_ready: bool = True) -> None:
        """Kills the processes. In joblib 1.6 the thread that manages them dies of a KeyError on calls that are on the
        way to none yet; the one that feeds them may still be at it when Python ends, and what it then leaves is
        reported as leaked.
        """
        with suppress(queue.Empty):
            while True:
                self._workers._work_ids.get_nowait()
        feeder = getattr(self._workers._call_queue, "_thread", None)
        super().abort_everything(ensure_ready)
        if feeder:
            feeder.join(_FEEDER_S)
