"""What all tables of a scenario have in common."""

from collections.abc import Iterator
from typing import Any

import msgspec

from meanflock.swarm.model import BEYOND_SENSE


class Table(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A TOML table: no unknown key, no number that is not finite, or whose square might not be."""

    def __post_init__(self) -> None:
        for name in self.__struct_fields__:
            for number in _flat(getattr(self, name)):
                if isinstance(number, float) and not abs(number) < BEYOND_SENSE:  # NaN is below nothing
                    raise ValueError(f"`{name}` must be a finite number within ±{BEYOND_SENSE:.0e}, not {number}")


def _flat(value: Any) -> Iterator[Any]:
    if isinstance(value, tuple | list | dict):  # the options of a plug-in, too
        for inner in value.values() if isinstance(value, dict) else value:
            yield from _flat(inner)
    else:
        yield value
