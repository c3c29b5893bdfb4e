"""Entry point of the `meanflock` command, which reports missing libraries."""

import meanflock.swarm.one_thread  # noqa: F401  # first: NumPy asks once
from meanflock.swarm.errors import needed


def main() -> None:
    """Run `meanflock.cli.command.main`; if a library is missing, print what to install."""
    with needed("the `meanflock` command", "ground"):
        from meanflock.cli.command import main as command

        command()


if __name__ == "__main__":
    main()
