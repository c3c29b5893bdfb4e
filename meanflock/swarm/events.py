"""Events of a flight, for log, recording and tables. Only a round has fields of its own; the others are words."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal, TypeAlias

import msgspec
from msgspec import Meta

_NAMED = 10  # UAVs that a text names, at most

Count: TypeAlias = Annotated[int, Meta(ge=0)]
Uavs: TypeAlias = tuple[Count, ...]


class Event(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True, eq=False, tag="event"):
    """An event of a flight in words; or the complaint of a node, which the world makes an event of."""

    tick: int
    kind: str
    text: str
    uavs: tuple[int, ...] = ()


class RoundEnded(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True, eq=False, tag="round"):
    """A round of the federation, when its uploads were averaged or could not be.

    Attributes:
        tick: when it ended. number: of the round, from 1. opened: tick in which its uploads began.
        outcome: `averaged`; `waiting`: the aggregation rule waits for more models; `void`: nothing was averaged.
        reason: why it is void; else empty.
        participants: N_h. absent: number of them that were lost or paused.
        sent: UAVs that sent, ascending. received: those whose upload, or a part of it, was there when the round was
            averaged. late: those whose upload was not, and came later. refused: those whose upload was received and
            could not be averaged.
        receiver: the UAV that receives all uploads; None if there are several.
        copies: messages over links to other UAVs; a model in fragments is one message for each. arrived: those that
            were there in time. copy: name of a copy, if an upload has several; else empty.
        earlier: late uploads of the round before, which count in this one.
        averaging: number of UAVs that averaged for themselves; None if one averages for others.
        isolated: number of UAVs that average for themselves and received nothing.
        fragments: number of fragments in which the average is broadcast; 1: it is whole.
        reached: number of UAVs that received the average; None if it goes in fragments, or by no radio.
        retries: uploads that were transmitted again.
        bits: payload bits of all traffic since take-off, up to the end of the round. airtime_s: likewise, s.
        diagnostics: means of the diagnostics in that tick over the UAVs on the way, by name.
        metrics: numbers that the aggregation rule reports, by name.
        shares: of each upload of `sent`, the share that was there when the round was averaged.
        delays_s: time after the opening at which its last part arrived, s; None if nothing did. Late ones count.
    """

    tick: Count
    number: Count
    opened: Count
    outcome: Literal["averaged", "waiting", "void"]
    reason: str = ""
    participants: Count = 0
    absent: Count = 0
    sent: Uavs = ()
    received: Uavs = ()
    late: Uavs = ()
    refused: Uavs = ()
    receiver: int | None = None
    copies: Count = 0
    arrived: Count = 0
    copy: str = ""
    earlier: Count = 0
    averaging: int | None = None
    isolated: Count = 0
    fragments: Count = 1
    reached: int | None = None
    retries: Count = 0
    bits: Count = 0
    airtime_s: float = 0.0
    diagnostics: dict[str, float] = {}
    metrics: dict[str, float] = {}
    shares: tuple[float, ...] = ()
    delays_s: tuple[float | None, ...] = ()

    @property
    def kind(self) -> str:
        """`round` or `void`."""
        return "void" if self.outcome == "void" else "round"

    @property
    def uavs(self) -> Uavs:
        """The UAVs that sent."""
        return self.sent

    @property
    def silent(self) -> int:
        """Number of participants that were there and did not send."""
        return self.participants - self.absent - len(self.sent)

    @property
    def lost(self) -> int:
        """Number of UAVs whose upload never arrived."""
        return len(set(self.sent).difference(self.received, self.late))

    @property
    def text(self) -> str:
        """The round in words."""
        if self.outcome == "void":
            return f"round {self.number} is void: {self.reason}; {self._account}"
        if self.outcome == "waiting":
            end = "the aggregation rule waits for more models"
        elif self.averaging is not None:
            end = f"averaged by {self.averaging} UAVs"
        elif self.reached is None:
            end = f"averaged and broadcast in {self.fragments} fragments"
        else:
            end = f"averaged and broadcast, received by {self.reached} UAVs"
        return f"round {self.number}: {self._account}; {end}"

    @property
    def _account(self) -> str:
        at = "" if self.receiver is None else f" by UAV {self.receiver}"
        parts = [
            f"{len(self.sent)} of {self.participants} participants sent",
            _some(self.silent, "silent"),
            _some(self.absent, "absent"),
            f"{len(self.received)} received{at}",
            _some(self.lost, "lost"),
            _some(len(self.late), f"late ({_named(self.late)})"),
            _some(len(self.refused), f"refused ({_named(self.refused)})"),
            f"{self.arrived} of {self.copies} {self.copy} arrived" if self.copy and self.copies else "",
            _some(self.earlier, "late from the round before averaged, too"),
            _some(self.isolated, "isolated"),
        ]
        return ", ".join(part for part in parts if part)


FlightEvent: TypeAlias = Event | RoundEnded


def uavs_of(event: FlightEvent) -> tuple[int, ...]:
    """All UAVs that an event names; some may be named twice."""
    if isinstance(event, RoundEnded):
        return (*event.sent, *event.received, *event.late, *event.refused)
    return event.uavs


def fields_of(ended: RoundEnded) -> dict[str, Any]:
    """All fields of a round, by name, as JSON has them."""
    fields = {name: getattr(ended, name) for name in RoundEnded.__struct_fields__}
    return {name: list(value) if isinstance(value, tuple) else value for name, value in fields.items()}


def round_of(fields: Mapping[str, Any]) -> RoundEnded:
    """The round with these fields.

    Raises:
        ValueError, KeyError: a field is missing or invalid.
    """
    return msgspec.convert(["round", *(fields[name] for name in RoundEnded.__struct_fields__)], RoundEnded)


def _some(count: int, noun: str) -> str:
    return f"{count} {noun}" if count else ""


def _named(uavs: Uavs) -> str:
    named = ", ".join(map(str, uavs[:_NAMED]))
    return f"UAV{'s' * (len(uavs) > 1)} {named}{', …' * (len(uavs) > _NAMED)}"
