"""The keys that a sweep varies, and their values."""

import json
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

from meanflock.swarm import mission
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario

LEARNER = "training.learner"


@dataclass(frozen=True)
class Swept:
    """A dotted key and its values, in TOML's types; lists and tables are written as text."""

    key: str
    values: tuple[Any, ...]

    @classmethod
    def parse(cls, text: str) -> "Swept":
        """`KEY=V1,V2,…`, the values in TOML syntax; bare words are strings.

        Raises:
            BadInput: no key, no value, or a value twice.
        """
        key, equals, listed = text.partition("=")
        key = key.strip()
        values = [_toml(value) if isinstance(value, list | dict) else value for value in _values(listed)]
        if not equals or not key or not values:
            raise BadInput(f"{text}: write it as KEY=VALUE,VALUE, for example wind.sigma=0.1,0.2,0.3")
        twice = [value for place, value in enumerate(values) if value in values[:place]]
        if twice:
            raise BadInput(f"{text}: {_toml(twice[0])} is there twice; give every value once")
        return cls(key, tuple(values))

    def setting(self, value: Any) -> str:
        """One value as `--set` takes it."""
        return f"{self.key}={_toml(value)}"

    def check(self, options: Mapping[str, Any], settings: Iterable[str]) -> None:
        """Check that no other argument sets the swept key.

        Args:
            options: values of flags, None if not given. settings: of `--set`.

        Raises:
            BadInput: another argument sets it.
        """
        for flag, given in options.items():
            if given is not None:
                raise BadInput(f"{flag} {given}: `{self.key}` is what is swept; leave out {flag}")
        refuse_setting(self.key, settings, "is what is swept")


@dataclass(frozen=True)
class Grid:
    """Several swept keys; a point has a value of each."""

    keys: tuple[Swept, ...]

    @classmethod
    def parse(cls, texts: Sequence[str]) -> "Grid":
        """The keys of several texts, each as for `Swept`.

        Raises:
            BadInput: as for `Swept.parse`, or a key is there twice.
        """
        keys = tuple(map(Swept.parse, texts))
        refuse_twice([one.key for one in keys])
        return cls(keys)

    def with_learners(self, learners: Sequence[str]) -> "Grid":
        """The grid with these values of `training.learner` added, if there are any.

        Raises:
            BadInput: that key is swept already.
        """
        if not learners:
            return self
        refuse_twice([*(one.key for one in self.keys), LEARNER])
        return Grid((*self.keys, Swept(LEARNER, tuple(dict.fromkeys(learners)))))

    def check_values(self) -> None:
        """Raise BadInput if a key has one value only."""
        for one in self.keys:
            if len(one.values) < 2:
                raise BadInput(f"{one.setting(one.values[0])}: a sweep needs two values or more, between commas")

    @property
    def has_methods(self) -> bool:
        """Returns whether the controller is one of the keys."""
        return any(one.key == "method" for one in self.keys)

    def points(self) -> Iterator[tuple[Any, ...]]:
        """All combinations of the values; those of the last key change fastest."""
        return product(*(one.values for one in self.keys))

    def settings(self, point: Sequence[Any]) -> list[str]:
        """A point as `--set` takes it."""
        return [one.setting(value) for one, value in zip(self.keys, point, strict=True)]


def refuse_twice(keys: Sequence[str]) -> None:
    """Raise BadInput if a key is swept twice."""
    if twice := [key for place, key in enumerate(keys) if key in keys[:place]]:
        raise BadInput(f"{twice[0]} is swept twice; give all its values at once")


def refuse_setting(key: str, settings: Iterable[str], reason: str) -> None:
    """Raise BadInput if `--set` sets a key that another argument decides."""
    for setting in settings:
        if setting.partition("=")[0].strip() == key:
            raise BadInput(f"--set {setting}: `{key}` {reason}; leave out this --set")


def refuse_method(flown: Scenario) -> None:
    """Raise BadInput if every group of a scenario names its controller, so that the one asked for flies no UAV."""
    if flown.every_group_has("method"):
        raise BadInput(
            f"`method` {flown.method} has no effect, because every group of the scenario names its controller; set "
            f"that of a group, as in groups.{flown.groups[0].name}.method={flown.method}, or remove `method` from one"
        )


def point_of(names: Sequence[str], values: Sequence[Any], flown: Scenario) -> tuple[Any, ...]:
    """The point of a scenario: the values of the varied keys, and as its method the controllers of all its groups.

    Args:
        names: of the keys, with `method`. values: of the keys in this order; `method` may be left out at the end.
    """
    given = dict(zip(names, values, strict=False)) | {"method": mission.method(flown)}
    return tuple(given[name] for name in names)


def add_point(points: dict[tuple[Any, ...], Scenario], at: tuple[Any, ...], flown: Scenario) -> None:
    """Add a scenario at its point. Raises BadInput if another scenario is there."""
    if points.setdefault(at, flown) != flown:
        raise BadInput(
            f"two different flights would both be called {', '.join(map(str, at))}, because their groups have the same "
            "controllers in other places; compare them one by one"
        )


def _values(listed: str) -> list[Any]:
    """Parse a TOML list without brackets; else words and numbers between commas."""
    try:
        return list(tomllib.loads(f"values = [{listed}]")["values"])
    except tomllib.TOMLDecodeError:
        return [_value(part.strip()) for part in listed.split(",") if part.strip()]


def _value(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def _toml(value: Any) -> str:
    """A value as TOML in a line; a text alone is a bare word."""
    if isinstance(value, list):
        return f"[{', '.join(map(_within, value))}]"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{_key(key)} = {_within(each)}' for key, each in value.items())}}}"
    return str(value).lower() if isinstance(value, bool) else str(value)


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _within(name)


def _within(value: Any) -> str:
    """A value within a list or table; texts have quotes."""
    if not isinstance(value, str):
        return _toml(value)
    return f"'{value}'" if value.isprintable() and "'" not in value else json.dumps(value)
