"""The keys of a scenario that was flown: how they differ from their defaults, and from the shipped scenarios."""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from meanflock.federation.plan import plan_of
from meanflock.swarm import scenario, toml
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario, as_builtins

PAPER = "paper"
_OF_THE_METHOD = ("federation.period", "federation.payload", "federation.broadcast_payload")  # unless they are set
_COLUMNS = ("method", "uavs", "seed")  # that a list shows beside the mission


class NamedMission(NamedTuple):
    """The scenario of a flight, and its changed keys: those that differ from the shipped scenario of that name, or from
    the paper's if there is none.

    As text, the name, and of a shipped scenario the number of changed keys. Other groups than its own are counted as
    groups.
    """

    name: str
    changed: dict[str, Any]

    def __str__(self) -> str:
        if self.name not in _shipped():
            return self.name
        groups = self.changed.get("groups") or []
        keys = len([key for key in self.changed if not (groups and key.partition(".")[0] == "groups")])
        text = f"{self.name} +{keys}" if keys else self.name
        return f"{text}, {len(groups)} group{'s' * (len(groups) > 1)}" if groups else text


def flat(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """The keys of a table, dotted, without those that are unset, also in tables of a list."""
    keys: dict[str, Any] = {}
    for key, value in table.items():
        if isinstance(value, Mapping):
            keys |= flat(value, f"{prefix}{key}.")
        elif value is not None:
            keys[f"{prefix}{key}"] = _set(value)
    return keys


def _set(value: Any) -> Any:
    """A value without the unset keys of its tables."""
    if isinstance(value, Mapping):
        return {key: _set(each) for key, each in value.items() if each is not None}
    return [_set(each) for each in value] if isinstance(value, list) else value


def differing(first: Mapping[str, Any], second: Mapping[str, Any]) -> dict[str, tuple[Any, Any]]:
    """The keys whose values differ, sorted, with both values; None: unset."""
    keys = sorted(first.keys() | second.keys())
    return {key: (first.get(key), second.get(key)) for key in keys if first.get(key) != second.get(key)}


def changed_keys(keys: Mapping[str, Any], other: Mapping[str, Any] | None = None) -> dict[str, tuple[Any, Any]]:
    """The keys of a flown scenario that differ from those of another one, by default from the defaults; both values.

    Keys of groups are as `--set` addresses them. The default of a group's key is what its flight has.
    """
    own = _without_own(keys)
    return differing(own, _defaults(PAPER) | _of_the_flight(own) if other is None else _without_own(other))


def _of_the_flight(keys: Mapping[str, Any]) -> dict[str, Any]:
    """For each key that a group sets, the value of its flight; None for an option of another controller."""
    found: dict[str, Any] = {}
    for key in keys:
        group, own = group_and_key(key)
        if group:
            is_alike = keys.get(f"groups.{group}.method", keys["method"]) == keys["method"]
            found[key] = keys.get(own) if is_alike or not own.startswith("controller.") else None
    return found


def group_and_key(key: str) -> tuple[str, str]:
    """The group that a key `groups.NAME.KEY` is of, and `KEY`; for a key of the flight no group, and the key."""
    if not key.startswith("groups."):
        return "", key
    _, group, own = key.split(".", 2)
    return group, own


def flown_mission(keys: Mapping[str, Any], name: str | None) -> NamedMission:
    """The scenario of a name; without one the shipped scenario from which the fewest keys differ.

    The changed keys are without options of the controller, and without method, number of UAVs and seed.
    """
    own = _without_own(keys)
    compared = _shipped() if name is None else [name if name in _shipped() else PAPER]
    found = {each: differing(own, _defaults(each)) for each in compared}
    nearest = min(found, key=lambda each: (len(found[each]), each != PAPER))
    changed = {
        key: value
        for key, (value, _) in found[nearest].items()
        if key not in _COLUMNS and not key.startswith("controller.")
    }
    return NamedMission(name or nearest, changed)


def _without_own(keys: Mapping[str, Any]) -> dict[str, Any]:
    """All keys, also those that the file leaves out, without those that have the value which the method decides."""
    keys = _defaults(PAPER) | dict(keys)
    radio = f"float{keys.get('radio.bits_per_float')}"
    decided: dict[str, Any] = dict.fromkeys(_OF_THE_METHOD[1:], radio)
    decided[_OF_THE_METHOD[0]] = _period(str(keys.get("method")))
    groups: list[Any] = keys.get("groups") or []
    sharing = [group["name"] for group in groups if _shares(str(group.get("method", keys.get("method"))))]
    decided["federation.group"] = sharing[0] if len(sharing) == 1 else sharing
    return _of_groups({key: value for key, value in keys.items() if key not in decided or value != decided[key]})


def _of_groups(keys: Mapping[str, Any]) -> dict[str, Any]:
    """All keys; those of groups as `--set` addresses them, `groups.NAME.KEY`, and `groups` has the names in order."""
    groups = keys["groups"]
    named = {f"groups.{group['name']}": {key: group[key] for key in group if key != "name"} for group in groups}
    return {**keys, "groups": [group["name"] for group in groups]} | flat(named)


@cache
def _period(method: str) -> int | None:
    """Ticks between rounds of a method, None if it is not installed here."""
    try:
        return Scenario(method=method).period_ticks
    except BadInput:
        return None


@cache
def _shares(method: str) -> bool:
    """Returns whether a method shares a model; False if it is not installed here."""
    try:
        return bool(plan_of(Scenario(method=method)).declared.is_federated)
    except BadInput:
        return False


@cache
def _shipped() -> tuple[str, ...]:
    return tuple(path.stem for path in toml.shipped())


@cache
def _defaults(name: str) -> dict[str, Any]:
    """All keys of a shipped scenario that are set or left out with a default, and the scale of its features."""
    loaded = scenario.load(Path(name))
    return _of_groups(flat(_values(loaded)) | {"learner.position_scale": loaded.position_scale_m})


def _values(table: msgspec.Struct) -> dict[str, Any]:
    values = {key: getattr(table, key) for key in table.__struct_fields__}
    return {
        key: _values(value) if isinstance(value, msgspec.Struct) else as_builtins(value)
        for key, value in values.items()
    }
