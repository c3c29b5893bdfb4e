"""Keeps libraries out of an agent's process that NumPy and msgspec load if they are installed, and work without.

`agent/__main__.py` imports this file first, and nothing else imports it. An agent of ours never needs these libraries,
and each process would carry them: OpenSSL alone, of which only hashes would be used, takes 3 MiB. A plug-in may import
whatever is installed, and may want what NumPy does with it, such as `array.ctypes`. So nothing is blocked where a
plug-in of somebody else is installed, or named to this process.
"""

import os
import sys
from importlib.metadata import entry_points
from importlib.util import find_spec

WITHOUT = ["ctypes", "typing_extensions"]
if find_spec("_sha2") or find_spec("_sha512"):  # Python's own, from 3.12 on and before; some builds leave them out
    WITHOUT.append("_hashlib")


def _may_fly_plugins_of_others() -> bool:
    installed = entry_points()
    points = [*installed.select(group="meanflock.controllers"), *installed.select(group="meanflock.filters")]
    named = os.environ.get("MEANFLOCK_PLUGINS") or any(flag.startswith("--p") for flag in sys.argv[1:])  # --plugin FILE
    return bool(named) or any(not point.value.startswith("meanflock.") for point in points)


if not _may_fly_plugins_of_others():
    for _name in WITHOUT:
        sys.modules.setdefault(_name, None)  # type: ignore[arg-type]  # an import of it fails as if it were not installed
