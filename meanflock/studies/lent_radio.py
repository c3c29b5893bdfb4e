"""The radio of one scenario, lent to others."""

from pathlib import Path
from typing import NamedTuple

from meanflock.swarm import toml

_ALSO = ("stations", "radios", "federation.station", "start.height")  # keys that are lent beside `[radio]`


class LentRadio(NamedTuple):
    """name: of the scenario that lends its radio. settings: that make it another scenario's, as of `--set`."""

    name: str
    settings: tuple[str, ...]


def lent_radio(path: Path) -> LentRadio:
    """The radio of a scenario: its table `[radio]`, and its stations, where it averages, and `start.height` if set.

    Raises:
        BadInput: the file cannot be read, or is no TOML.
    """
    table = toml.read(path, "scenario file")
    settings = [f"radio={toml.inline(table.get('radio', {}))}"]
    for key in _ALSO:
        *parents, name = key.split(".")
        part = table
        for parent in parents:
            part = part.get(parent, {})
        if name in part:
            settings.append(f"{key}={toml.inline(part[name])}")
    return LentRadio(path.stem, tuple(settings))
