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
            annotated, name = field.type, prefix + field.name
            if isinstance(annotated, inspect.UnionType):  # of the value and None
                annotated = next((one for one in annotated.types if isinstance(one, inspect.Metadata)), annotated)
            if isinstance(annotated, inspect.Metadata):
                if annotated.extra:
                    found[name] = annotated.extra[_KEY]
                annotated = annotated.type
            if isinstance(annotated, inspect.StructType):
                describe(annotated, f"{name}.")

    describe(inspect.type_info(kind), "")
    return found
