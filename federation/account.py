"""Records of the rounds: an account of each, which says what became of its models, and a hash of all models shared.

Flights whose federations did the same, to the last bit, have equal hashes.
"""

import hashlib
import re
from collections.abc import Iterable
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import Frames

_NAMED = 10  # UAVs that a text names, at most


class Shares(NamedTuple):
    """Shares of a round, NaN where there is nothing to share.

    received: delivered in time, of all copies of uploads. silent: of the participants. late: of the UAVs that sent.
    isolated: number of UAVs that averaged for themselves and received nothing.
    """

    number: int
    received: float
    silent: float
    late: float
    isolated: int


class Account(msgspec.Struct, array_like=True):
    """Account of the uploads of one round.

    Attributes:
        participants: N_h. absent: those of them that were lost or paused.
        sent: UAVs that sent, ascending.
        copies: messages over links to other UAVs; a model in fragments is one message for each. arrived: those that
            were there when the round was averaged.
        received, late: UAVs whose upload, or a part of it, reached any UAV that averages in time, or later.
        refused: UAVs whose upload was received and could not be averaged.
        earlier: late uploads of the round before, which count in this one.
    """

    participants: int
    absent: int
    sent: list[int]
    copies: int = 0
    arrived: int = 0
    earlier: int = 0
    received: set[int] = set()
    late: set[int] = set()
    refused: set[int] = set()

    def transmit(self, links: NDArray[np.int32], rows: NDArray[np.intp], is_late: NDArray[np.bool_]) -> None:
        """Counts uploads on the air over links (K, 5), with `rows` (K,) messages each, and which of them are late."""
        self.copies += int(rows.sum())
        self.late.update(links[is_late, 1].tolist())

    def receive(self, senders: Iterable[int], copies: int) -> None:
        """Counts the mail of this round that is there when it is averaged."""
        self.received.update(senders)
        self.arrived += copies

    def words(self, at: str, name: str, isolated: int = 0) -> str:
        """The account in words.

        Args:
            at: the UAV that received them, if it is one. name: of the copies, if they are more than one an upload.
            isolated: number of UAVs that average for themselves and received nothing.
        """
        late = sorted(self.late - self.received)
        lost = len(self.sent) - len(self.received.union(late) & set(self.sent))
        parts = [
            f"{len(self.sent)} of {self.participants} participants sent",
            _some(self.participants - self.absent - len(self.sent), "silent"),
            _some(self.absent, "absent"),
            f"{len(self.received)} received{at}",
            _some(lost, "lost"),
            _some(len(late), f"late ({_uavs(late)})"),
            _some(len(self.refused), f"refused ({_uavs(sorted(self.refused))})"),
            f"{self.arrived} of {self.copies} {name} arrived" if name and self.copies else "",
            _some(self.earlier, "late from the round before averaged, too"),
            _some(isolated, "isolated"),
        ]
        return ", ".join(part for part in parts if part)

    def snapshot(self) -> list[Any]:
        """All of it, for `restored`; sets are ascending lists."""
        fields: list[Any] = msgspec.to_builtins(self, order="sorted")
        return fields

    @classmethod
    def restored(cls, snapshot: list[Any]) -> "Account":
        """The account of a snapshot."""
        return msgspec.convert(snapshot, cls)


def shares(text: str) -> Shares | None:
    """The shares in the text of an event of kind `round` or `void`; None: it has no account of a round."""
    sent = re.search(r"^round (\d+)\b.*?(\d+) of (\d+) participants sent", text)
    if sent is None:
        return None
    number, senders, participants = map(int, sent.groups())

    def count(pattern: str) -> int:
        found = re.search(rf"(\d+) {pattern}", text)
        return int(found[1]) if found else 0

    arrived, copies = count("received"), senders
    if over_links := re.search(r"(\d+) of (\d+) \w+ arrived", text):
        arrived, copies = map(int, over_links.groups())
    return Shares(
        number,
        arrived / copies if copies else np.nan,
        count("silent") / participants,
        count(r"late \(") / senders if senders else np.nan,
        count("isolated"),
    )


def _some(count: int, noun: str) -> str:
    return f"{count} {noun}" if count else ""


def _uavs(uavs: list[int]) -> str:
    named = ", ".join(map(str, uavs[:_NAMED]))
    return f"UAV{'s' * (len(uavs) > 1)} {named}{', …' * (len(uavs) > _NAMED)}"


class ModelsHash:
    """Hash of the global models, as they are coded, in the order in which they are broadcast.

    Where no global model goes by radio, as with the topology `neighbours`, the uploads count in their place.
    """

    def __init__(self, scenario: Scenario) -> None:
        by_radio = [hop.label for hop in scenario.hops if not hop.is_local]
        self._label = by_radio[-1] if by_radio else None
        self.digest = b""  # after the models so far; empty before the first

    @property
    def hexdigest(self) -> str | None:
        """The hash as text; None if no model was sent."""
        return self.digest.hex() or None

    def add(self, frames: Iterable[Frames]) -> None:
        """Add the models among the frames of a tick, sources ascending."""
        for batch in frames:
            if batch.kind == self._label:
                form = f"{batch.round} {batch.payload.dtype.str} {batch.payload.shape}".encode()
                whole = hashlib.sha256(self.digest + form + batch.source.astype("<i4").tobytes())
                whole.update(np.ascontiguousarray(batch.payload).data)
                self.digest = whole.digest()
