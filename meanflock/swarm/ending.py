"""End of a process: as at the end of any program, but the system takes the interpreter's memory back.

To take the interpreter apart would cost a forked process a copy of all that it shares, five times what it needs to end.
"""

import atexit
import logging
import os
import sys
from contextlib import suppress
from typing import NoReturn

_THREADS_S = 5.0  # most time for threads to end after everything else

_code: int | None = None  # exit code of this process, once it ends


def end(code: int) -> NoReturn:
    """Ends this process. Threads that a plug-in has started are waited for, for a limited time."""
    import threading  # only here: the command is quick without it

    global _code
    _code = code
    if any(not thread.daemon for thread in threading.enumerate() if thread is not threading.main_thread()):
        _flush()
        late = threading.Timer(_THREADS_S, os._exit, (code,))
        late.daemon = True  # so that the timer does not keep the process alive
        late.start()
    sys.exit(code)


@atexit.register
def _leave() -> None:
    """Leave the interpreter as it is. Python calls this after the functions that were registered later."""
    if _code is not None:
        logging.shutdown()
        _flush()
        os._exit(_code)


def _flush() -> None:
    """Write what is printed, and what native code printed if something has loaded what reaches it."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError, AttributeError):  # closed, or never open
            stream.flush()
    if (native := sys.modules.get("ctypes")) is not None:
        native.CDLL(None).fflush(None)
