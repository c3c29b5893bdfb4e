"""Error messages for invalid scenarios: the key, what was expected, what it is, and how to fix it."""

import re
import reprlib
from collections.abc import Iterator
from typing import Any

from msgspec import inspect

from meanflock.swarm.errors import most_similar

NAME = "^[A-Za-z][A-Za-z0-9_-]{0,31}$"
REMEDY = "`meanflock scenario schema` lists every key with its unit and bounds"
_NAME_TYPE = f"`str` matching regex '{NAME}'"
_NAME_IN_WORDS = "a letter and at most 31 letters, digits, - and _ behind it"
_WORDS = {
    "int": "a whole number",
    "float": "a number",
    "str": "text",
    "bool": "true or false",
    "array": "a list",
    "object": "a table",
    "null": "nothing",
}


def explain(message: str, root: type, table: dict[str, Any], where: str = "", remedy: str = REMEDY) -> str:
    """Translate an error of msgspec about a `table`, which should be a `root`, into a message for users.

    `where`: key of that table, if it is part of another. `remedy`: a text that names the command that lists the keys.
    """
    text, _, path = message.partition(" - at ")
    place = path.removeprefix("`key` in ").strip("`").removeprefix("$").removeprefix(".")
    shown = _with_name(table, place)
    whole = ".".join(filter(None, (where, shown)))
    prefix = f"{whole}: " if whole else ""
    unknown = re.search(r"unknown field `(.*)`", text)
    if unknown:
        meant = ".".join(filter(None, (where, _meant(root, place, shown, unknown[1]))))
        meant = f"; did you mean `{meant}`?" if meant != where else ""
        return f"{prefix}there is no key `{unknown[1]}`{meant}; {remedy}"
    if lacks := re.search(r"missing required field (`.*`)", text):
        return f"{prefix}it lacks the key {lacks[1]}; add it; {remedy}"
    if text.startswith("Invalid "):
        choices, got = _choices(root, place), _value_at(table, place)
        return f"{prefix}{f'expected one of {choices}, got {got}' if choices and got else text}; {remedy}"
    if text.startswith("Expected "):
        text = re.sub(r"`([\w |]+)`", lambda found: _in_words(found[1]), text.replace(_NAME_TYPE, _NAME_IN_WORDS))
        expected, _, got = text.partition(", got ")
        got = _value_at(table, place) or got
        if got.startswith("{") and any(isinstance(part, inspect.StructType) for part in _at(root, f"{place}[0]")):
            got += f"; write [[{whole}]] in place of [{whole}]"
        return f"{prefix}e{expected[1:]}{f', got {got}' if got else ''}; {remedy}"
    return prefix + (text if ";" in text else f"{text}; {remedy}")


def _in_words(types: str) -> str:
    """Types as msgspec names them, such as `int | null`, in words without `null`."""
    names = [name for name in types.split(" | ") if name != "null"] or ["null"]
    return " or ".join(_WORDS.get(name, f"`{name}`") for name in names)


_STEP = re.compile(r"[^.\[\]]+|\[[^\]]*\]")  # step of a path: a key, or an index in brackets


def _value_at(table: dict[str, Any], place: str) -> str:
    """The value at a path, as text; empty if the path is unknown, as for entries of a dict."""
    value: Any = table
    try:
        for step in _STEP.findall(place):
            value = value[int(step[1:-1])] if step.startswith("[") else value[step]
    except (LookupError, ValueError):
        return ""
    return str(value).lower() if isinstance(value, bool) else reprlib.repr(value)


def _with_name(table: dict[str, Any], place: str) -> str:
    """A path as `--set` addresses it: `groups.NAME` in place of the number of a group that has a name."""
    if not (numbered := re.match(r"groups\[(\d+)\]", place)):
        return place
    group = table["groups"][int(numbered[1])]
    name = group.get("name") if isinstance(group, dict) else None
    return f"groups.{name}{place[numbered.end() :]}" if isinstance(name, str) and re.match(NAME, name) else place


def _parts(kind: inspect.Type) -> list[inspect.Type]:
    """The members of a union or the type itself, without bounds."""
    if isinstance(kind, inspect.Metadata):
        return _parts(kind.type)
    if isinstance(kind, inspect.UnionType):
        return [part for one in kind.types for part in _parts(one)]
    return [kind]


def _at(root: type, place: str) -> list[inspect.Type]:
    """The types that a value at a path such as `faults[0].kind` may have; none if there is no such path."""
    found = _parts(inspect.type_info(root))
    for name in _STEP.findall(place):
        inner: list[inspect.Type] = []
        for kind in found:
            if name.startswith("["):
                item = getattr(kind, "item_type", None)
                inner += _parts(item) if item is not None else []
            elif isinstance(kind, inspect.StructType):
                inner += [part for field in kind.fields if field.encode_name == name for part in _parts(field.type)]
        found = inner
    return found


def _choices(root: type, place: str) -> str:
    """The allowed values at a path, if they are an enumeration; else an empty text."""
    values: list[Any] = []
    for kind in _at(root, place):
        if isinstance(kind, inspect.LiteralType):
            values += kind.values
        elif isinstance(kind, inspect.EnumType):
            values += list(kind.cls)
    table, _, last = place.rpartition(".")
    values += [kind.tag for kind in _at(root, table) if isinstance(kind, inspect.StructType) and kind.tag_field == last]
    return ", ".join(str(value) for value in values)


def _meant(root: type, place: str, shown: str, name: str) -> str | None:
    """The most similar key of this table, else the only equal key of the other tables; None in a list of tables.

    In no table, an equal key comes first.

    Tables that only some methods read are none of these: in most flights such a key would do nothing.
    """
    tables = [kind for kind in _at(root, place) if isinstance(kind, inspect.StructType)]
    here = sorted({field.encode_name for table in tables for field in table.fields})
    keys = list(_keys(inspect.type_info(root)))
    same = [key for key in keys if key.rpartition(".")[2] == name]
    close = most_similar(name, here)
    if close and (place or not same):
        return f"{shown}.{close}" if place else close
    if place.endswith("]"):
        return None
    if same:
        return same[0] if len(same) == 1 else None
    return None if place else most_similar(name, keys)


def _keys(kind: inspect.Type, path: str = "") -> Iterator[str]:
    """All dotted keys of a table, without those of tables that only some methods read."""
    for part in _parts(kind):
        if isinstance(part, inspect.StructType) and not getattr(part.cls, "of_some_methods", False):
            for field in part.fields:
                yield path + field.encode_name
                yield from _keys(field.type, f"{path}{field.encode_name}.")
