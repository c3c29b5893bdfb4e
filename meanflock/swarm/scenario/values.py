"""Scenarios as plain values: keys that Python code sets, validation of a table, and a table as TOML text."""

import operator
import re
from collections.abc import Collection, Mapping
from typing import Any, NamedTuple, TypeVar

import msgspec
import numpy as np

from meanflock.swarm import plugins
from meanflock.swarm.declared import NO_FILTER, NO_LEARNER
from meanflock.swarm.errors import BadInput, available
from meanflock.swarm.toml import put

Kind = TypeVar("Kind")
_COUNT = re.compile(r"groups\.[^.]+\.count")  # the key of the number of UAVs of a group

PLUGIN_KEYS: dict[str, plugins.PluginKind] = {  # keys that name a plug-in, and may be its class
    "method": "controller",
    "training.learner": "learner",
    "federation.aggregation": "aggregator",
    "federation.topology": "topology",
    "federation.payload": "coding",
    "federation.broadcast_payload": "coding",
    "radio.model": "channel",
    "vehicle.model": "vehicle",
    "filter.kind": "filter",
}


def as_builtins(value: Any) -> Any:
    """Convert a Python value to numbers, texts, lists and dicts, as JSON would return it.

    Raises:
        TypeError: the value has another type.
    """
    if isinstance(value, set | frozenset):  # the order of its values is anyone's
        raise TypeError("a scenario has no values of type set")
    return _with_lists(msgspec.to_builtins(value, enc_hook=_as_number_or_list))


def _as_number_or_list(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    if hasattr(value, "__index__"):
        return operator.index(value)
    raise TypeError(f"a scenario has no values of type {type(value).__name__}")


def _with_lists(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _with_lists(inner) for key, inner in value.items()}
    return [_with_lists(inner) for inner in value] if isinstance(value, list | tuple) else value


def with_keys(table: dict[str, Any], settings: Mapping[str, Any], kind: type[Kind], where: str) -> Kind:
    """The scenario that a table describes once dotted keys of it are set to Python values.

    A key that names a plug-in, such as `method`, may be its class, which is then registered.

    Raises:
        BadInput: a value has a type that a scenario cannot contain, a key leads through a value that is not a table, or
            the scenario is invalid, see `validated`.
    """
    for key, value in settings.items():
        if key in PLUGIN_KEYS and value is not None:
            value = plugins.name_of(key, value, PLUGIN_KEYS[key])
        try:
            put(table, key, as_builtins(value))
        except TypeError as error:
            raise BadInput(f"{key}: {error}; give a number, a text, a list or a dict") from error
    return validated(table, kind, where, settings)


class Switch(NamedTuple):
    """A key that switches other keys on: its table, its off value, an example of an on value, and the other keys."""

    table: str
    key: str
    off: Any
    example: str
    others: tuple[str, ...] | None = None  # None: all others of the table


SWITCHES = (
    Switch("filter", "kind", NO_FILTER, "ecbf"),
    Switch("training", "learner", NO_LEARNER, "digits"),
    Switch("cost", "separation", 0.0, "0.1", ("separation_range",)),
    Switch("wind", "field_rms", 0.0, "0.5", ("field_length", "field_modes")),
    Switch("federation", "byzantine_fraction", 0.0, "0.2", ("byzantine_kind",)),
)


def check_switches(table: Mapping[str, Any], single: Collection[str] = ()) -> None:
    """Reject keys that have no effect, because their switch is off by default.

    A switch that is set to its off value, as in a complete scenario file or a sweep, is allowed.

    Args:
        single: dotted keys that were set one by one, on top of the table.

    Raises:
        ValueError: a key is set without its switch; the message names both.
    """
    for name, switch, off, example, others in SWITCHES:
        given = table.get(name)
        if not isinstance(given, Mapping) or f"{name}.{switch}" in single or given.get(switch, off) != off:
            continue
        for key in given:
            depends = key != switch and (others is None or key in others)
            if depends and (switch not in given or any(f"{one}.".startswith(f"{name}.{key}.") for one in single)):
                raise ValueError(
                    f"`{name}.{key}` has no effect without `{name}.{switch}`; set that too, for example "
                    f"{name}.{switch}={example}"
                )


def validated(table: dict[str, Any], kind: type[Kind], where: str, single: Collection[str] = ()) -> Kind:
    """The scenario, or another `kind` of table, that a table of plain values describes.

    If the `count` of a group was set one by one and `uavs` was not, `uavs` is the sum of all counts.

    Args:
        where: source of the table, for the message.
        single: dotted keys of the table that were set one by one, on top of a file or a scenario.

    Raises:
        BadInput: unknown key, wrong type, value out of range, or a key that has no effect without another. The
            message names the key, its value, the bound, and how to fix it.
    """
    if isinstance(table.get("groups"), Mapping):
        raise BadInput(
            f"{where}: `groups` are several tables, and there are none; name a scenario that has groups, or write each "
            "as [[groups]] with a `name`"
        )
    if any(map(_COUNT.fullmatch, single)) and {"uavs", "groups"}.isdisjoint(single):
        counts = [group.get("count") for group in table["groups"] if isinstance(group, dict)]
        if all(isinstance(count, int) and count > 0 for count in counts):  # otherwise the error is about a count
            table = {**table, "uavs": sum(counts)}
    try:
        result = msgspec.convert(table, kind)
        check_switches(table, single)
    except msgspec.ValidationError as error:
        from meanflock.swarm.explain import explain  # only here: nodes receive valid scenarios

        raise BadInput(f"{where}: {explain(str(error), kind, table)}") from error
    except ValueError as error:
        raise BadInput(f"{where}: {error}") from error
    return result


def toml_text(table: msgspec.Struct) -> str:
    """A scenario as TOML text: all keys that are set, sorted.

    Raises:
        BadInput: an option of a plug-in is None, which TOML cannot express; or the library that writes TOML is missing.
    """
    with available("a scenario as TOML", "ground"):
        import tomli_w  # only here: agents and leaders write no TOML
    try:
        return tomli_w.dumps(_without_unset(msgspec.to_builtins(table, order="sorted")))
    except TypeError as error:
        raise BadInput("an option of a plug-in is None, and TOML has no such value; leave that option out") from error


def _without_unset(table: dict[str, Any]) -> dict[str, Any]:
    """A table, and the tables in it, without keys that are None; options of plug-ins stay as they are."""
    present = {key: value for key, value in table.items() if value is not None}
    nested = {key for key, value in present.items() if isinstance(value, dict)} - {"controller", "options"}
    present |= {key: _without_unset(present[key]) for key in nested}
    if "groups" in present:
        present["groups"] = [_without_unset(group) for group in present["groups"]]
    return present
