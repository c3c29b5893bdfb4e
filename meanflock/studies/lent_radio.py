"""The radio of one scenario, lent to others."""

from pathlib import Path
from typing import NamedTuple

from meanflock.swarm import toml


class LentRadio(NamedTuple):
    """name: of the scenario that lends its radio. settings: that make it another scenario's, as of `--set`."""

    name: str
    settings: tuple[str, ...]


def lent_radio(path: Path) -> LentRadio:
    """The radio of a scenario: its table `[radio]`, and `start.height` if it is set.

    Raises:
        BadInput: the file cannot be read, or is no TOML.
    """
    table = toml.read(path, "scenario file")
    settings = [f"radio={toml.inline(table.get('radio', {}))}"]
    if (height := table.get("start", {}).get("height")) is not None:
        settings.append(f"start.height={toml.inline(height)}")
    return LentRadio(path.stem, tuple(settings))
