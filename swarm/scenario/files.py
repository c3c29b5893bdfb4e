"""Reader of scenario files and fault scripts (TOML), and the JSON form of a scenario between processes."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import msgspec

from meanflock.swarm import toml
from meanflock.swarm.errors import BadInput
from meanflock.swarm.faults import Fault
from meanflock.swarm.scenario.scenario import Scenario
from meanflock.swarm.scenario.values import validated
from meanflock.swarm.toml import Table as _Table


class _Script(_Table, frozen=True):
    """A file with faults only."""

    faults: tuple[Fault, ...]


def encode(scenario: Scenario) -> bytes:
    """Canonical JSON, keys sorted."""
    return msgspec.json.encode(scenario, order="sorted")


def decode(raw: bytes) -> Scenario:
    """A scenario from JSON.

    Raises:
        BadInput: not a valid scenario.
    """
    try:
        return msgspec.json.decode(raw, type=Scenario)
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise BadInput(f"scenario: {error}") from error


def read_faults(path: Path) -> list[dict[str, Any]]:
    """The `[[faults]]` of a TOML file that has nothing else, for `load(..., faults=...)`.

    Raises:
        BadInput: unreadable file, or not a fault script; the message names the file, the fault and the key.
    """
    table = toml.read(path, "fault script")
    if set(table) != {"faults"}:
        raise BadInput(f"{path}: a fault script has [[faults]] and nothing else, see scenarios/faults.toml")
    validated(table, _Script, str(path))
    faults: list[dict[str, Any]] = table["faults"]
    return faults


def schema() -> dict[str, Any]:
    """JSON schema of a scenario file, with units and bounds."""
    return msgspec.json.schema(Scenario)


def load(path: Path | None, settings: Iterable[str] = (), **options: Any) -> Scenario:
    """Reads a TOML file (None: the paper's scenario), then applies `a.b=c` settings, then named options.

    Raises:
        BadInput: unreadable file, bad TOML, unknown key, wrong type or value out of range, or a key that has no
            effect without another; the message names the file or setting, the key and the bound.
    """
    table: dict[str, Any] = {}
    where = "scenario"
    if path is not None:
        where = str(path)
        table = toml.read(path, "scenario file")
    single = [toml.apply(table, setting) for setting in settings]
    table.update({name: value for name, value in options.items() if value is not None})
    return validated(table, Scenario, where, single)
