"""The `meanflock` command as it is installed: what it needs beyond an agent's libraries may be missing."""

import sys
from importlib.util import find_spec

import meanflock.swarm.one_thread  # noqa: F401  # first: NumPy asks once
from meanflock.swarm.errors import EXIT_BAD_INPUT

EXTRA = "ground"


def main() -> None:
    """See `groundstation.cli.main`; where a library is missing, one line says which, and what to install."""
    try:
        from meanflock.groundstation.cli import main as command

        command()
    except ModuleNotFoundError as missing:
        library = (missing.name or "").partition(".")[0]
        if library in ("meanflock", "") or _is_there(library):
            raise
        mend = f"pip install 'meanflock[{EXTRA}]'"
        print(
            f"error: {library} is not installed, and `meanflock` needs more than an agent does: {mend}", file=sys.stderr
        )
        raise SystemExit(EXIT_BAD_INPUT) from None


def _is_there(library: str) -> bool:
    """Whether it is a part of an installed library that is missing: a defect, and no matter of extras."""
    try:
        return find_spec(library) is not None
    except ValueError:
        return False
