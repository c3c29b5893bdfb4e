"""What all events of a flight have in common."""

import re
from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal, TypeAlias

import msgspec
from msgspec import Meta

_NAMED = 10  # UAVs that a text names, at most
_LISTED = 1000  # UAVs in a list

Count: TypeAlias = Annotated[int, Meta(ge=0)]
Uavs: TypeAlias = tuple[Count, ...]
Level: TypeAlias = Literal["INFO", "WARN", "ERROR"]


def _dashed(name: str) -> str:
    return re.sub(r"(?<!^)(?=[A-Z])", "-", name).lower()


class BaseEvent(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True, tag=_dashed):
    """An event of a flight. Its class declares the kind, its meaning and its level in a log.

    Attributes:
        meanings: what an event of the class means, by kind; the first kind is that of an event if it has no other.
        level: severity of an event.
        tick: when it happened.
    """

    meanings: ClassVar[Mapping[str, str]]
    level: ClassVar[Level] = "INFO"
    tick: Count

    @property
    def kind(self) -> str:
        """The kind of the event."""
        return next(iter(self.meanings))

    @property
    def text(self) -> str:
        """The event in words."""
        raise NotImplementedError

    @property
    def uavs(self) -> Uavs:
        """The UAVs concerned."""
        return ()

    @property
    def all_uavs(self) -> Uavs:
        """All UAVs in the fields; some may be there twice."""
        return self.uavs


def counted(uavs: int) -> str:
    """A number of UAVs in words, as `3 UAVs`."""
    return f"{uavs} UAV{'s' * (uavs != 1)}"


def listed(uavs: Uavs) -> str:
    """UAVs in words, as `UAVs 3, 5`. Of very many the first, and how many others."""
    shown = f"UAV{'s' * (len(uavs) > 1)} {', '.join(map(str, uavs[:_LISTED]))}"
    return shown if len(uavs) <= _LISTED else f"{shown} and {len(uavs) - _LISTED:,} others"


def named(uavs: Uavs) -> str:
    """The first UAVs in words, as `UAVs 3, 5, …`."""
    shown = ", ".join(map(str, uavs[:_NAMED]))
    return f"UAV{'s' * (len(uavs) > 1)} {shown}{', …' * (len(uavs) > _NAMED)}"
