"""Events of the federation's rounds."""

from typing import Literal

from meanflock.swarm.events.base import BaseEvent, Count, Uavs, counted, listed, named


class RoundEnded(BaseEvent, frozen=True):
    """A round of the federation, when its uploads were averaged or could not be.

    Attributes:
        tick: when it ended. number: of the round, from 1. opened: tick in which its uploads began.
        outcome: `averaged`; `waiting`: the aggregation rule waits for more models; `void`: nothing was averaged.
        reason: why it is void; else empty.
        participants: N_h. absent: number of them that were lost or paused.
        sent: UAVs that sent, ascending. received: those whose upload, or a part of it, was there when the round was
            averaged. late: those whose upload was not, and came later. refused: those whose upload was received and
            could not be averaged.
        receiver: the UAV that receives all uploads; None if there are several, or a station does.
        copies: messages over links to other UAVs; a model in fragments is one message for each. arrived: those that
            were there in time. copy: name of a copy, if an upload has several; else empty.
        earlier: late uploads of the round before, which count in this one.
        averaging: number of UAVs that averaged for themselves; None if one averages for others.
        isolated: number of UAVs that average for themselves and received nothing.
        fragments: number of fragments in which the average is broadcast; 1: it is whole.
        reached: number of UAVs that received the average; None if it goes in fragments, again or by no radio.
        retries: uploads that were transmitted again.
        bits: payload bits of all traffic since take-off, up to the end of the round. airtime_s: likewise, s.
        diagnostics: means of the diagnostics in that tick over the UAVs on the way, by name.
        metrics: numbers that the aggregation rule reports, by name.
        shares: of each upload of `sent`, the share that was there when the round was averaged.
        delays_s: time after the opening at which its last part arrived, s; None if nothing did. Late ones count.
        station: the station that receives all uploads; None if UAVs do.
    """

    meanings = {
        "round": "a round was averaged: how many participants sent, were silent or absent (lost or paused), how many "
        "uploads were received, lost, late or refused, and how many UAVs received the average; `uavs`: those that sent",
        "void": "a round had nothing to average; its account is as above",
    }
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
    station: int | None = None

    @property
    def kind(self) -> str:
        """`round` or `void`."""
        return "void" if self.outcome == "void" else "round"

    @property
    def uavs(self) -> Uavs:
        """The UAVs that sent."""
        return self.sent

    @property
    def all_uavs(self) -> Uavs:
        return (*self.sent, *self.received, *self.late, *self.refused)

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
            end = f"averaged by {counted(self.averaging)}"
        elif self.reached is None:
            end = "averaged and broadcast" + (f" in {self.fragments} fragments" if self.fragments > 1 else "")
        else:
            end = f"averaged and broadcast, received by {counted(self.reached)}"
        return f"round {self.number}: {self._account}; {end}"

    @property
    def _account(self) -> str:
        at = "" if self.receiver is None else f" by UAV {self.receiver}"
        if self.station is not None:
            at = f" by station {self.station}"
        parts = [
            f"{len(self.sent)} of {self.participants} participants sent",
            _some(self.silent, "silent"),
            _some(self.absent, "absent"),
            f"{len(self.received)} received{at}",
            _some(self.lost, "lost"),
            _some(len(self.late), f"late ({named(self.late)})"),
            _some(len(self.refused), f"refused ({named(self.refused)})"),
            f"{self.arrived} of {self.copies} {self.copy} arrived" if self.copy and self.copies else "",
            _some(self.earlier, "late from the round before averaged, too"),
            _some(self.isolated, "isolated"),
        ]
        return ", ".join(part for part in parts if part)


class FragmentsReceived(BaseEvent, frozen=True):
    """The global model of a round was broadcast in fragments, or again where it was lost.

    Attributes:
        number: of the round. fragments: number of fragments that were broadcast.
        whole: UAVs that received all of them. partly: some of them. nothing: none.
    """

    meanings = {"round": "how many UAVs received a global model that was broadcast in fragments, or again"}
    number: Count
    fragments: Count
    whole: Count
    partly: Count
    nothing: Count

    @property
    def text(self) -> str:
        if self.fragments == 1:
            return f"round {self.number}: the global model was received by {counted(self.whole)}, not by {self.nothing}"
        return (
            f"round {self.number}: {self.fragments} fragments of the global model were received whole by "
            f"{counted(self.whole)}, in part by {self.partly}, not at all by {self.nothing}"
        )


class ClusterLeftOut(BaseEvent, frozen=True):
    """A round goes on without a cluster. number: of the round. head: UAV that averages for the cluster."""

    meanings = {"void": "a cluster's part of a round had nothing to average"}
    number: Count
    head: Count
    reason: str

    @property
    def text(self) -> str:
        return f"round {self.number} goes on without the cluster of UAV {self.head}: {self.reason}"

    @property
    def all_uavs(self) -> Uavs:
        return (self.head,)


class UploadsRefused(BaseEvent, frozen=True):
    """Uploads of UAVs were received and could not be averaged."""

    meanings = {"refused": "uploads were not averaged (the summary counts all)"}
    uavs: Uavs

    @property
    def text(self) -> str:
        return f"uploads of {listed(self.uavs)} were not averaged"


def _some(count: int, noun: str) -> str:
    return f"{count} {noun}" if count else ""
