"""The Rerun recording of a flight: made of its telemetry, shown, and rendered.

Rerun is imported here first. What fails comes back as an exception; the coloured lines that Rerun would write to
standard error as well are switched off, unless the user set RUST_LOG. Rerun reads that variable when it is imported.
Zenoh reads it too, in this process and in those it starts, so it is set for the import alone.
"""

import os

_LEVEL = "RUST_LOG"
_is_ours = _LEVEL not in os.environ
os.environ.setdefault(_LEVEL, "off")
try:
    import rerun as rr
    import rerun.blueprint as rrb
finally:
    if _is_ours:
        del os.environ[_LEVEL]

__all__ = ("rr", "rrb")
