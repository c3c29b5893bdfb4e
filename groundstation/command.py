"""The `meanflock` command as it is installed: what it needs beyond an agent's libraries may be missing."""

import sys

import meanflock.swarm.one_thread  # noqa: F401  # first: NumPy asks once
from meanflock.swarm.errors import EXIT_RUN_FAILED
from meanflock.swarm.libraries import needed


def main() -> None:
    """See `groundstation.cli.main`; where a library is missing, one line says which, and what to install."""
    with needed("the `meanflock` command", "ground"):
        try:
            from meanflock.groundstation.cli import main as command
        except KeyboardInterrupt:
            print("error: interrupted", file=sys.stderr)
            raise SystemExit(EXIT_RUN_FAILED) from None
        command()
