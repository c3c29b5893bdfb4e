"""The `meanflock` command as it is installed: what it needs beyond an agent's libraries may be missing."""

import meanflock.swarm.one_thread  # noqa: F401  # first: NumPy asks once
from meanflock.swarm.errors import needed


def main() -> None:
    """See `groundstation.cli.command.main`; where a library is missing, one line says which, and what to install."""
    with needed("the `meanflock` command", "ground"):
        from meanflock.groundstation.cli.command import main as command

        command()


if __name__ == "__main__":
    main()
