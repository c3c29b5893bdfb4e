"""Description of the keys of a scenario: all that a reader, a plot, the reference and the hash need, in one place."""

from functools import cache
from typing import Any, Literal, NamedTuple, TypeAlias

import msgspec
from msgspec import Meta

Paper: TypeAlias = Literal["printed", "no number", "–"]
PRINTED: Paper = "printed"  # the default is the value that the paper prints
SILENT: Paper = "no number"  # the paper has the quantity, but no value
OURS: Paper = "–"  # the paper has no such quantity

_KEY = "key"  # of `Meta.extra`
_COUNTED = ("UAVs", "ticks", "slots", "bit")  # units that a description names anyway


class Key(NamedTuple):
    """Description of a key.

    about: what it is. paper: what the paper says of its value. why: the reason for the default. unit: empty for a
    number without one. later: it enters the hash only if it differs from its default, so that older scenarios keep
    their hash.
    """

    about: str = ""
    paper: Paper = OURS
    why: str = ""
    unit: str = ""
    later: bool = False


def key(about: str, paper: Paper, why: str, unit: str = "", later: bool = False, **bounds: Any) -> Meta:
    """The annotation of a key. `bounds`: those of msgspec, such as `ge=0`."""
    ending = "" if unit in ("", *_COUNTED) else f", {unit.replace(', ', ' and ')}"
    return Meta(description=about + ending, extra={_KEY: Key(about, paper, why, unit, later)}, **bounds)


LATER = Meta(extra={_KEY: Key(later=True)})  # annotation of a table


@cache
def keys_of(kind: type[msgspec.Struct]) -> dict[str, Key]:
    """The description of each dotted key of a scenario; a table comes before its keys."""
    from msgspec import inspect  # only here: agents describe no keys

    found: dict[str, Key] = {}

    def describe(table: Any, prefix: str) -> None:
        for field in table.fields:
            inner, said = _described(inspect, field.type)
            if said is not None:
                found[prefix + field.name] = said
            if isinstance(inner, inspect.StructType):
                describe(inner, f"{prefix}{field.name}.")

    describe(inspect.type_info(kind), "")
    return found


def _described(inspect: Any, of: Any) -> tuple[Any, Key | None]:
    """The type itself, and its description."""
    if isinstance(of, inspect.Metadata):
        return of.type, (of.extra or {}).get(_KEY)
    if isinstance(of, inspect.UnionType):
        return of, next((said for one in of.types if (said := _described(inspect, one)[1]) is not None), None)
    return of, None
