"""Post: the world's part in the rounds. It carries, counts and keeps models, and never reads one."""

from collections.abc import Callable, Iterable
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from meanflock.federation.schedule import Schedule
from meanflock.federation.topology.base import Hop, Role
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import contains
from meanflock.swarm.wire.messages import FrameKind, Frames

Note: TypeAlias = Callable[[str, str], None]  # kind and text of an event


class Mailbox:
    """The mail of one UAV that averages, until its round is averaged. A node reads each frame once, a new node all."""

    def __init__(self) -> None:
        self._frames: list[Frames] = []
        self._read = 0  # of them, by this node:
        self._reader: str | None = None
        self.is_addressed = False  # mail was sent here since it was last closed, delivered or not

    def put(self, frames: Frames) -> None:
        """Adds frames whose links all end at this UAV."""
        self._frames.append(frames)

    def read(self, reader: str) -> tuple[Frames, ...]:
        """The frames that a node, by name, has not read yet."""
        if reader != self._reader:
            self._reader, self._read = reader, 0
        unread = tuple(self._frames[self._read :])
        self._read = len(self._frames)
        return unread

    def close(self, number: int) -> None:
        """Drops the mail of a round and of all before it."""
        read = self._frames[: self._read]
        self._frames = [frames for frames in self._frames if frames.round > number]
        self._read = sum(frames.round > number for frames in read)
        self.is_addressed = False

    def snapshot(self) -> list[Any]:
        """The mail, for `restore`; the node that averages after it reads everything."""
        return [self.is_addressed, [[int(f.kind), f.round, f.source, f.payload, f.links] for f in self._frames]]

    def restore(self, snapshot: list[Any]) -> None:
        """Goes on with the mail of a snapshot."""
        self.is_addressed, frames = snapshot
        self._frames = [Frames(FrameKind(kind), *fields) for kind, *fields in frames]
        self._read, self._reader = 0, None


class Post:
    """All that the world knows of the rounds.

    Attributes:
        rounds: rounds averaged and broadcast. rounds_void: rounds closed without a model of another UAV.
        rule_record: the state of the leader's aggregation rule, a record.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._schedule = Schedule(scenario)
        self._schedule.draw_ahead()
        self._hops = self._schedule.hops
        self.rounds = 0
        self.rounds_void = 0
        self._averaged = 0  # number of the last round that was
        self.rule_record = b""
        self._boxes = {
            (place, uav): Mailbox()
            for place, hop in enumerate(self._hops)
            if hop.mail is not None
            for uav in hop.senders.tolist()
        }
        self._addressed: list[tuple[Role, int, Mailbox]] = []  # the boxes that mail was sent to, by hop and UAV

    # -- before a tick's requests -------------------------------------------------------------------------------

    def deliver(self, tick: int, due: Iterable[Frames], awake: NDArray[np.bool_]) -> list[Frames]:
        """Keeps the mail among the frames that arrive now, for UAVs that are `awake` (N,); returns the rest."""
        rest, is_new = [], False
        for frames in due:
            hop = self._schedule.sent(frames.kind, frames.round, tick)
            place = next((k for k, one in enumerate(self._hops) if hop is not None and one.mail is hop), None)
            if place is None:
                rest.append(frames)
                continue
            assert frames.links is not None
            for uav in np.unique(frames.links[:, 1]).tolist():
                box = self._boxes[place, uav]
                is_new = is_new or not box.is_addressed
                box.is_addressed = True
                if awake[uav]:
                    box.put(only(frames, frames.links[frames.links[:, 1] == uav]))
        if is_new:
            self._list_addressed()
        return rest

    @property
    def has_mail(self) -> bool:
        """Whether mail was sent to any UAV in a round that is open."""
        return bool(self._addressed)

    def mail(self, role: Role, reader: str, uavs: NDArray[np.intp] | None = None) -> tuple[Frames, ...]:
        """The unread mail of a node of some role and name, for its `uavs` (M,); None: of all."""
        found: list[Frames] = []
        for reading, uav, box in self._addressed:
            if reading == role and (uavs is None or uav in uavs):
                found += box.read(reader)
        return tuple(found)

    def leader_is_due(self, tick: int, awake: NDArray[np.bool_]) -> bool:
        """Whether the leader has anything to do in this tick. It has not while its UAV is lost or paused."""
        return self._schedule.is_open(tick) and any(
            bool(awake[hop.senders].any()) for hop in self._hops if hop.role == "leader"
        )

    # -- the frames that nodes send -----------------------------------------------------------------------------

    def check(self, role: Role, frames: Frames) -> None:
        """Validates frames that a node of some role sends in a round, but for their time and the node's UAVs.

        Raises:
            MessageRejected: `wrong-kind`, `wrong-shape` or `non-finite`.
        """
        hop = next((hop for hop in self._hops if hop.label == frames.kind and hop.role == role), None)
        if hop is None:
            raise MessageRejected("wrong-kind", f"{frames.kind.name} frames from a node of role {role}")
        if not contains(hop.senders, frames.source).all():
            raise MessageRejected("wrong-shape", f"{frames.kind.name} frames of UAVs {frames.source.tolist()}")
        hop.coding.check(frames.source, frames.payload)

    def check_refused(self, role: Role, tick: int, senders: NDArray[np.int32], uavs: NDArray[np.intp]) -> None:
        """Validates that a node may refuse to average the models of `senders`: it averages in this tick, at `uavs`.

        Raises:
            MessageRejected: `wrong-shape`.
        """
        for hop in self._hops:
            if hop.mail is None or hop.role != role:
                continue
            if role == "leader":
                return
            targets = hop.mail.targets
            if self._schedule.number(hop, tick) and (
                targets is None or bool(np.isin(targets[senders], uavs).any(axis=-1).all())
            ):
                return
        raise MessageRejected("wrong-shape", "refused names uploads to others")

    def stray(self, frames: Frames, tick: int) -> MessageRejected | None:
        """The reason why frames do not belong to a round that transmits in this tick; None where they do.

        Frames of a kind go on the air as those of one round, so a node that names another would take all models there.
        """
        hop = self._hop(frames.kind, tick)
        expected = 0 if hop is None else self._schedule.number(hop, tick)
        is_last = any(one.is_last and one.label == frames.kind for one in self._hops)
        if is_last and frames.round <= self._averaged:
            return MessageRejected("duplicate", f"round {frames.round} has been averaged")
        if hop is None or frames.round != expected:
            return MessageRejected("wrong-round", f"{frames.kind.name} of round {frames.round}, expected {expected}")
        if hop.mail is None:
            taking = contains(self._schedule.participants(expected), frames.source)
            if not taking.all():
                strangers = frames.source[~taking].tolist()
                return MessageRejected("wrong-round", f"UAVs {strangers} take no part in round {expected}")
        return None

    # -- after a tick's transmissions ---------------------------------------------------------------------------

    def close(
        self,
        tick: int,
        frames: Iterable[Frames],
        links: NDArray[np.int32],
        awake: NDArray[np.bool_],
        has_leader: Callable[[], bool],
        note: Note,
    ) -> None:
        """Closes the hops that transmitted in this tick `frames` over `links` (K, 5), and notes what came of them."""
        if not self._schedule.is_busy(tick):
            return
        for place, hop in enumerate(self._hops):
            if hop.mail is None or not (number := self._schedule.number(hop, tick)):
                continue
            sent = {uav for batch in frames if batch.kind == hop.label for uav in batch.source.tolist()}
            if hop.is_last:
                self._end(hop, number, bool(sent), awake, has_leader, note)
            else:
                lost = set(links[(links[:, 3] == hop.label) & (links[:, 4] < 0), 1].tolist())
                for uav in hop.senders.tolist():
                    if uav in lost or (self._boxes[place, uav].is_addressed and uav not in sent):
                        why = "its relay is lost" if uav in lost else "its head is silent"
                        note("void", f"round {number} goes on without the cluster of UAV {uav}: {why}")
            for uav in hop.senders.tolist():
                self._boxes[place, uav].close(number)
            self._list_addressed()

    def snapshot(self) -> dict[str, Any]:
        """All of it, for `restore`."""
        return {
            "counts": [self.rounds, self.rounds_void, self._averaged],
            "rule": self.rule_record,
            "boxes": [box.snapshot() for box in self._boxes.values()],
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Goes on where a snapshot was taken."""
        self.rounds, self.rounds_void, self._averaged = map(int, snapshot["counts"])
        self.rule_record = bytes(snapshot["rule"])
        for box, mail in zip(self._boxes.values(), snapshot["boxes"], strict=True):
            box.restore(mail)
        self._list_addressed()

    def _list_addressed(self) -> None:
        self._addressed = [
            (self._hops[place].role, uav, box) for (place, uav), box in self._boxes.items() if box.is_addressed
        ]

    def _hop(self, label: FrameKind, tick: int) -> Hop | None:
        """The hop of a label that transmits in this tick."""
        return next((hop for hop in self._hops if hop.label == label and self._schedule.number(hop, tick)), None)

    def _end(
        self,
        hop: Hop,
        number: int,
        is_averaged: bool,
        awake: NDArray[np.bool_],
        has_leader: Callable[[], bool],
        note: Note,
    ) -> None:
        """Counts a round that ends, and notes it."""
        if is_averaged:
            self.rounds += 1
            self._averaged = number
            note("round", f"round {number} averaged and broadcast")
            return
        self.rounds_void += 1
        why = "no model of another UAV was averaged"
        if hop.role == "leader" and not awake[hop.senders].any():
            why = f"UAV {self._scenario.federation.leader}, which averages, is lost or paused"
        elif hop.role == "leader" and not has_leader():
            why = "there is no leader"
        note("void", f"round {number} is void: {why}")


def only(frames: Frames, links: NDArray[np.int32]) -> Frames:
    """Frames reduced to some of their links."""
    used = np.zeros(len(frames.source), dtype=bool)
    used[links[:, 0]] = True
    if len(used) == 1 or np.logical_and.reduce(used):
        return (
            frames if links is frames.links else Frames(frames.kind, frames.round, frames.source, frames.payload, links)
        )
    place = np.cumsum(used, dtype=np.int32) - 1  # of a row among those that are used
    renumbered = np.stack([place[links[:, 0]], links[:, 1]], axis=-1)
    return Frames(frames.kind, frames.round, frames.source[used], frames.payload[used], renumbered)
