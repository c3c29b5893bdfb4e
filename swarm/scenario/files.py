"""Scenarios read and written: TOML files and tables of plain values, and JSON between processes."""

from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any

import msgspec

from meanflock.swarm import toml
from meanflock.swarm.errors import BadInput
from meanflock.swarm.faults import Fault
from meanflock.swarm.scenario import switches
from meanflock.swarm.scenario.scenario import Scenario
from meanflock.swarm.table import Table as _Table


class _Script(_Table, frozen=True):
    """A file of faults alone."""

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
    """The `[[faults]]` of a TOML file that holds nothing else, as `load(..., faults=...)` takes them.

    Raises:
        BadInput: unreadable file, or not a fault script; the message names the file, the fault and the key.
    """
    table = toml.read(path, "fault script")
    if set(table) != {"faults"}:
        raise BadInput(f"{path}: a fault script holds [[faults]] and nothing else, see scenarios/faults.toml")
    try:
        msgspec.convert(table, _Script)
    except msgspec.ValidationError as error:
        raise BadInput(f"{path}: {_explain(error, _Script)}") from error
    faults: list[dict[str, Any]] = table["faults"]
    return faults


def schema() -> dict[str, Any]:
    """JSON schema of a scenario file, with units and bounds."""
    return msgspec.json.schema(Scenario)


def load(path: Path | None, settings: Iterable[str] = (), **options: Any) -> Scenario:
    """Reads a TOML file (none: the paper's scenario), then applies `a.b=c` settings, then named options.

    Raises:
        BadInput: unreadable file, bad TOML, unknown key, wrong type or value out of range, or a key that does nothing
            without another; the message names the file or setting, the key and the bound.
    """
    table: dict[str, Any] = {}
    where = "scenario"
    if path is not None:
        where = str(path)
        table = toml.read(path, "scenario file")
    said = [toml.apply(table, setting) for setting in settings]
    table.update({name: value for name, value in options.items() if value is not None})
    return from_table(table, where, said)


def from_table(table: dict[str, Any], where: str, said: Collection[str] = ()) -> Scenario:
    """The scenario a table of plain values says; `where` it comes from. `said`: dotted keys of it that were set one by
    one, on top of a file or a scenario.

    Raises:
        BadInput: unknown key, wrong type or value out of range, or a key that does nothing without another.
    """
    try:
        flown = msgspec.convert(table, Scenario)
        switches.check(table, said)
    except msgspec.ValidationError as error:
        raise BadInput(f"{where}: {_explain(error, Scenario)}") from error
    except ValueError as error:
        raise BadInput(f"{where}: {error}") from error
    return flown


def _explain(error: msgspec.ValidationError, kind: type) -> str:
    from meanflock.swarm.explain import explain  # only here: nodes are sent scenarios that are sound

    return explain(str(error), kind)
