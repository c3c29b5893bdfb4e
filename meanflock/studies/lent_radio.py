"""The radio of one scenario, lent to others."""

from pathlib import Path
from typing import NamedTuple

from meanflock.swarm import toml
from meanflock.swarm.errors import BadInput

_ALSO = ("stations", "radios", "federation.station", "start.height")  # keys that are lent beside `[radio]`


class LentRadio(NamedTuple):
    """name: of the scenario that lends its radio. settings: that make it another scenario's, as of `--set`."""

    name: str
    settings: tuple[str, ...]


def lent_radio(path: Path) -> LentRadio:
    """The radio of a scenario: its table `[radio]`, and its stations, where it averages, and `start.height` if set.

    Raises:
        BadInput: the file cannot be read, is no TOML, or has a value in place of a table; the message names `--radio`.
    """
    try:
        table = toml.read(path, "scenario file")
    except BadInput as error:
        raise BadInput(f"--radio {error}") from error
    settings = [f"radio={toml.inline(table.get('radio', {}))}"]
    for key in _ALSO:
        *parents, name = key.split(".")
        part = table
        for parent in parents:
            part = part.get(parent, {})
            if not isinstance(part, dict):
                raise BadInput(f"--radio {path}: `{parent}` is {part!r}, and must be a table; write it as [{parent}]")
        if name in part:
            settings.append(f"{key}={toml.inline(part[name])}")
    return LentRadio(path.stem, tuple(settings))
