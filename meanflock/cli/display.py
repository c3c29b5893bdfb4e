"""Check that a window can be opened on this display."""

import os
import socket
import sys
from pathlib import Path

from meanflock.swarm.errors import RunFailed

_X_PORT = 6000  # of display 0, over TCP
_ANSWER_S = 3.0


def check(instead: str) -> None:
    """Check that a window can be opened.

    Args:
        instead: end of the message: what works without a window.

    Raises:
        RunFailed: there is no display, or it does not answer.
    """
    if sys.platform in ("darwin", "win32"):
        return
    wayland, x = os.environ.get("WAYLAND_DISPLAY"), os.environ.get("DISPLAY")
    if os.environ.get("WAYLAND_SOCKET") or (wayland and _answers(_wayland(wayland))) or (x and _answers(_x(x))):
        return
    tried = [f"{name}={value}" for name, value in (("WAYLAND_DISPLAY", wayland), ("DISPLAY", x)) if value]
    reason = f"no server answers at {', '.join(tried)}" if tried else "neither DISPLAY nor WAYLAND_DISPLAY is set"
    raise RunFailed(f"no display to open a window on: {reason}; {instead}")


def _wayland(name: str) -> list[str]:
    return [str(Path(os.environ.get("XDG_RUNTIME_DIR", "/")) / name)]


def _x(name: str) -> list[str | tuple[str, int]]:
    """Addresses of the X server of a display such as `:0` or `localhost:10.0`; none for another text."""
    host, colon, rest = name.rpartition(":")
    number = rest.partition(".")[0]
    if not colon or not number.isdecimal():
        return []
    if host not in ("", "unix"):
        return [(host, _X_PORT + int(number))]
    path = f"/tmp/.X11-unix/X{number}"
    return [path, f"\0{path}"]


def _answers(places: "list[str] | list[str | tuple[str, int]]") -> bool:
    for place in places:
        family = socket.AF_UNIX if isinstance(place, str) else socket.AF_INET
        with socket.socket(family) as probe:
            probe.settimeout(_ANSWER_S)
            try:
                probe.connect(place)
                return True
            except (OSError, OverflowError, ValueError):  # no server, or an invalid address
                continue
    return False
