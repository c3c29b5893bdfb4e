"""Scenarios as plain values: keys that Python code sets, validation of a table, and a table as TOML text."""

from collections.abc import Collection, Mapping
from typing import Any, NamedTuple, TypeVar

import msgspec
import numpy as np

from meanflock.swarm import plugins
from meanflock.swarm.declared import NO_FILTER
from meanflock.swarm.errors import BadInput, lacking
from meanflock.swarm.toml import put

Kind = TypeVar("Kind")


def as_builtins(value: Any) -> Any:
    """A Python value as JSON would return it: a number, text, list or dict in place of what NumPy or a table has.

    Raises:
        TypeError: the value has another type.
    """
    return _with_lists(msgspec.to_builtins(value, enc_hook=_from_numpy))


def _from_numpy(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    raise TypeError(f"a scenario holds no {type(value).__name__}")


def _with_lists(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _with_lists(inner) for key, inner in value.items()}
    return [_with_lists(inner) for inner in value] if isinstance(value, list | tuple) else value


def set_keys(table: dict[str, Any], settings: Mapping[str, Any]) -> None:
    """Sets dotted keys of `table` to Python values. `method` may be a controller's class, which is then registered.

    Raises:
        BadInput: a value has a type that no scenario holds, or a key leads through something that is no table.
    """
    for key, value in settings.items():
        if key == "method" and isinstance(value, type):
            plugins.register(value)
            value = value.name  # type: ignore[attr-defined]
        elif key == "method" and not isinstance(value, str):
            raise BadInput(f"method: {value!r} is no name of a controller and no class; give one of these")
        try:
            put(table, key, as_builtins(value))
        except TypeError as error:
            raise BadInput(f"{key}: {error}; give a number, a text, a list or a dict") from error


class Switch(NamedTuple):
    """A key of a table, its value that turns something off, one that does not, and the keys that then do nothing."""

    table: str
    key: str
    off: Any
    example: str
    others: tuple[str, ...] | None = None  # none: all others of the table


SWITCHES = (
    Switch("filter", "kind", NO_FILTER, "ecbf"),
    Switch("cost", "separation", 0.0, "0.1", ("separation_range",)),
    Switch("wind", "field_rms", 0.0, "0.5", ("field_length", "field_modes")),
    Switch("federation", "byzantine_fraction", 0.0, "0.2", ("byzantine_kind",)),
)


def check_switches(table: Mapping[str, Any], said: Collection[str] = ()) -> None:
    """Nothing is set for nothing, in what a person wrote of a scenario. A switch that is off where it was said to be
    is what was wanted: of a scenario that is written out, or in a sweep of it.

    Args:
        said: dotted keys of the table that were set on top of it, one by one.

    Raises:
        ValueError: a key is set whose switch is not; the message names both.
    """
    for name, switch, off, example, others in SWITCHES:
        given = table.get(name)
        if not isinstance(given, Mapping) or f"{name}.{switch}" in said or given.get(switch, off) != off:
            continue
        for key in given:
            of_it = key != switch and (others is None or key in others)
            if of_it and (switch not in given or any(f"{one}.".startswith(f"{name}.{key}.") for one in said)):
                raise ValueError(
                    f"`{name}.{key}` does nothing without `{name}.{switch}`; set that too, for example "
                    f"{name}.{switch}={example}"
                )


def validated(table: dict[str, Any], kind: type[Kind], where: str, single: Collection[str] = ()) -> Kind:
    """The scenario, or another `kind` of table, that a table of plain values describes.

    Args:
        where: source of the table, for the message.
        single: dotted keys of the table that were set one by one, on top of a file or a scenario.

    Raises:
        BadInput: unknown key, wrong type, value out of range, or a key that does nothing without another. The message
            names the key, its value, the bound, and how to mend it.
    """
    try:
        made = msgspec.convert(table, kind)
        check_switches(table, single)
    except msgspec.ValidationError as error:
        from meanflock.swarm.explain import explain  # only here: nodes receive valid scenarios

        raise BadInput(f"{where}: {explain(str(error), kind, table)}") from error
    except ValueError as error:
        raise BadInput(f"{where}: {error}") from error
    return made


def toml_text(table: msgspec.Struct) -> str:
    """TOML with every key of a scenario that is set, keys sorted.

    Raises:
        BadInput: an option of a plug-in is None, which TOML cannot express; or the library that writes TOML is missing.
    """
    try:
        import tomli_w  # only here: agents and leaders write no TOML

        return tomli_w.dumps(_without_unset(msgspec.to_builtins(table, order="sorted")))
    except ModuleNotFoundError as error:
        raise BadInput(lacking(error, "a scenario as TOML", "ground")) from error
    except TypeError as error:
        raise BadInput("an option of a plug-in is None, and TOML has no such value; leave that option out") from error


def _without_unset(table: dict[str, Any]) -> dict[str, Any]:
    """A table, and the tables in it, without keys that are None; options of plug-ins stay as they are."""
    present = {key: value for key, value in table.items() if value is not None}
    nested = {key for key, value in present.items() if isinstance(value, dict)} - {"controller", "options"}
    return {key: _without_unset(value) if key in nested else value for key, value in present.items()}
