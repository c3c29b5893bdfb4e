"""Ledger: the world's part in the rounds. It carries, counts and stores models, and never reads one."""

from collections.abc import Callable, Iterable, Sequence
from functools import cached_property
from typing import Any, Literal, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.federation.account import Account
from meanflock.federation.averager import RuleVerdict, verdict_of
from meanflock.federation.mailbox import Letter, Mailbox, links_of
from meanflock.federation.plan import Plan
from meanflock.federation.schedule import Schedule
from meanflock.federation.seat import name_of
from meanflock.federation.topology.base import Hop, Role
from meanflock.federation.transmission import Acknowledge, Reception, Transmission
from meanflock.swarm import plugins
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.events import ClusterLeftOut, FlightEvent, FragmentsReceived, RoundEnded
from meanflock.swarm.state import Mask, contains, distinct
from meanflock.swarm.stateful import Stateful
from meanflock.swarm.wire.messages import NOBODY, FrameKind, Frames, LinkColumn

Indices: TypeAlias = NDArray[np.intp]


class Ledger(Stateful):
    """All that the world knows of the rounds.

    Attributes:
        rounds: rounds in which models were averaged. rounds_void: rounds in which nothing was: no model of another UAV
            arrived, or the rule failed. A round after which the rule waits for more models is neither.
        late: uploads that were delivered after their round had been averaged, and counted in the next one.
        silent: participants, summed over rounds, that were awake and sent no model.
        isolated: UAVs and rounds in which a UAV that averages for itself received nobody's model.
        retries: fragments that were transmitted again.
        rule_record: the state of the leader's aggregation rule, a record. is_done: the rule wants no further round.
        newest: number of the last letter that came.
    """

    stored = (
        *("rounds", "rounds_void", "late", "silent", "isolated", "retries", "_averaged", "newest"),
        *("rule_record", "is_done", "transmissions", "_reception", "_mailboxes", "accounts"),
    )

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._scenario = scenario = plan.scenario
        self._schedule = Schedule(plan)
        self._schedule.draw_ahead()
        self._hops = self._schedule.hops
        self.rounds = 0
        self.rounds_void = 0
        self.late = 0
        self.silent = 0
        self.isolated = 0
        self.retries = 0
        self.newest = 0
        self._averaged = 0  # number of the last round that was
        self._accounts: dict[int, Account] = {}  # of the rounds that are open
        self._refused: set[int] = set()  # UAVs whose models nodes refused to average in this tick
        self.rule_record = b""
        self.is_done = False
        self._verdict = RuleVerdict()  # of this tick
        rule = plugins.load("aggregator", scenario.federation.aggregation) if self._hops else None
        self._is_asked_void = getattr(rule, "asked_void", False)
        self._attempts = scenario.federation.retries
        self._transmissions: list[Transmission] = []
        self._reception = Reception(scenario.nodes)
        self._again: set[tuple[FrameKind, int]] = set()  # kinds and rounds of what is on the air again in this tick
        self._has_failed = False  # whether the leader complained in this tick
        self._failed: list[int] = []  # UAVs at which the aggregation rule failed in this tick
        self._waiting: NDArray[np.integer] = NOBODY  # UAVs at which it waits for more models after this tick
        self._members = scenario.members
        self._mailboxes = [Mailbox(hop, scenario.nodes) for hop in self._hops if hop.mail is not None]
        # Ticks from the opening of a round until its uploads are averaged, by their label
        self._uploads = {hop.mail.label: hop.after for hop in self._hops if hop.mail and hop.mail.mail is None}

    # -- before a tick's requests -------------------------------------------------------------------------------

    def deliver(self, tick: int, due: Sequence[Frames], awake: NDArray[np.bool_]) -> list[Frames]:
        """Keeps the mail among the frames that arrive now, for nodes that are `awake` (N + B,); returns the rest."""
        rest = []
        for frames in due:
            if (arrived := self._new(frames, awake)) is None:
                continue
            hop = self._schedule.sent(frames.kind, frames.round, tick)
            box = next((box for box in self._mailboxes if hop is not None and box.hop.mail is hop), None)
            if box is None:
                rest.append(arrived)
                if hop is not None and hop.is_last and self._schedule.spreads:
                    self._reception.receive(arrived, awake)
                continue
            self.newest += 1
            box.put(self.newest, arrived, awake)
            if (
                self._scenario.federation.deadline is not None
                and self._schedule.age(frames.round, tick) > box.hop.after
            ):
                self.late += len(np.unique(frames.source[links_of(frames)[:, 0]]))
        return rest

    @property
    def letters(self) -> tuple[Letter, ...]:
        """The mail that waits to be averaged; see `mailbox.mail_for`."""
        return tuple(letter for box in self._mailboxes for letter in box.letters)

    def is_busy(self, tick: int) -> bool:
        """Returns whether models may be on the air in a tick, or a hop of a round closes after it."""
        return bool(self._transmissions) or self._schedule.is_busy(tick)

    def leader_is_due(self, tick: int, awake: NDArray[np.bool_]) -> bool:
        """Returns whether the leader has anything to do in this tick. It has not while its UAV or station is lost or
        paused."""
        number = self._schedule.open_round(tick)
        return number > 0 and any(
            bool(awake[self._plan.senders(hop, number)].any()) for hop in self._hops if hop.role == "leader"
        )

    # -- the frames that nodes send -----------------------------------------------------------------------------

    def check(self, role: Role, frames: Frames) -> None:
        """Validates frames that a node of some role sends in a round, but for their time and the node's UAVs.

        Raises:
            MessageRejected: `wrong-kind`, `wrong-shape` or `non-finite`.
        """
        hop = next(
            (hop for hop in self._hops if hop.label == frames.kind and hop.role == role and not hop.is_local), None
        )
        if hop is None:
            raise MessageRejected("wrong-kind", f"{frames.kind.name} frames from a node of role {role}")
        if not contains(hop.senders, frames.source).all():
            raise MessageRejected("wrong-shape", f"{frames.kind.name} frames of UAVs {frames.source.tolist()}")
        # A fragment that nobody sent is the mean of no model; where models are not cut, that is not sent at all.
        least = 1 if hop.codec.count == 1 else 0
        hop.codec.check(frames.source, frames.payload, least, hop.newest_base(frames.round))

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

    def check_waiting(self, tick: int, uavs: NDArray[np.int32]) -> None:
        """Validates that the aggregation rule may wait at `uavs` of an agent: they average by it in this tick.

        Raises:
            MessageRejected: `wrong-shape`.
        """
        for hop in self._hops:
            asks_rule = hop.role == "agent" and hop.averages == "models"
            if asks_rule and self._schedule.number(hop, tick) and contains(hop.senders, uavs).all():
                return
        raise MessageRejected("wrong-shape", "waiting names UAVs that do not average")

    def round_error(self, frames: Frames, tick: int) -> MessageRejected | None:
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
            participants = contains(self._schedule.participants(expected), frames.source)
            if not participants.all():
                outsiders = frames.source[~participants].tolist()
                return MessageRejected("wrong-round", f"UAVs {outsiders} take no part in round {expected}")
        return None

    def refuse(self, uavs: Iterable[int]) -> None:
        """Takes notice that a node did not average the models of some UAVs in this tick."""
        self._refused.update(uavs)

    def take_record(self, record: bytes) -> None:
        """Takes the record that the leader's aggregation rule left in this tick.

        Raises:
            MessageRejected: it is malformed.
        """
        self._verdict = verdict_of(record)
        self.rule_record, self.is_done = record, self._verdict.is_done

    def fail(self) -> None:
        """Takes notice that the leader could not average in this tick, and said why."""
        self._has_failed = True

    def fail_at(self, uavs: Iterable[int]) -> None:
        """Takes notice of the UAVs at which the aggregation rule failed in this tick."""
        self._failed = list(uavs)

    def wait_at(self, uavs: NDArray[np.integer]) -> None:
        """Takes notice of the UAVs at which the aggregation rule waits for more models after this tick."""
        self._waiting = uavs

    # -- the frames that go on the air ----------------------------------------------------------------------------

    def transmitted(self, tick: int, frames: list[Frames], awake: Mask, acknowledge: Acknowledge) -> list[Frames]:
        """Frames of nodes that are awake (N + B,) on the air now: of `frames`, sent in this tick, and earlier ones.

        Of models, as many fragments go in a tick as their slots hold; all else goes at once. After the last round that
        the aggregation rule wants, no model goes.
        """
        self._again = set()
        if not (self._transmissions or any(batch.kind != FrameKind.STATE for batch in frames)):
            return frames
        on_air = [batch for batch in frames if batch.kind == FrameKind.STATE]
        for batch in frames:
            hop = self._hop(batch.kind, tick)
            if hop is not None and not (self.is_done and hop.mail is None):
                wanted = self._wanted(hop, batch)
                self._transmissions.append(Transmission(hop, batch, wanted, tick, hop.attempt_ticks, self._attempts))
        for one in self._transmissions:
            before = one.again
            cut = one.next(tick, awake, acknowledge)
            if cut is not None:
                on_air.append(cut)
            if one.again > before:
                self.retries += one.again - before
                self._again.add((one.frames.kind, one.frames.round))
                if (account := self._accounts.get(one.frames.round)) is not None:
                    account.retries += one.again - before
        self._transmissions = [one for one in self._transmissions if not one.is_over(tick)]
        return on_air

    def _wanted(self, hop: Hop, frames: Frames) -> Mask:
        """The fragments (R,) of models that are transmitted: of averages, those of which something arrived."""
        box = next((box for box in self._mailboxes if box.hop is hop), None)
        if box is None or self._is_asked_void:
            return np.ones(len(frames.source), dtype=bool)
        uavs = distinct(frames.source)
        arrived = np.stack([box.fragments(uav) for uav in uavs.tolist()])
        return np.asarray(arrived[uavs.searchsorted(frames.source), hop.codec.places(frames.payload)])

    def _new(self, frames: Frames, awake: Mask) -> Frames | None:
        """Frames that arrive, without the fragments that came by an earlier attempt; None for none."""
        found: Frames | None = frames
        for one in self._transmissions:
            if found is not None:
                found = one.new(found, awake)
        return found

    # -- after a tick's transmissions ---------------------------------------------------------------------------

    def close(
        self,
        tick: int,
        frames: Iterable[Frames],
        on_air: Iterable[Frames],
        links: NDArray[np.int32],
        awake: NDArray[np.bool_],
        has_leader: bool,
        note: Callable[[FlightEvent], None],
    ) -> list[RoundEnded]:
        """Closes the hops in which nodes sent `frames` in this tick; returns the rounds that end, and notes the rest.

        Args:
            on_air: what was transmitted in this tick, over `links` (K, 7). awake: (N + B,). has_leader: whether a node
                leads.
        """
        is_busy = self._schedule.is_busy(tick)
        if is_busy:
            self._open_accounts(tick, frames, awake)
        self._follow(tick, on_air, links)
        ended: list[RoundEnded] = []
        if not is_busy:
            return ended
        if (last := self._schedule.ends(tick)) and (end := self._reception.close(self._other(awake, last))):
            note(FragmentsReceived(tick, last, *end))
        for box in self._mailboxes:
            hop = box.hop
            if not (number := self._schedule.number(hop, tick)):
                continue
            if self.is_done and number not in self._accounts:  # it opened after the last one that the rule wanted
                continue
            self._receive(hop, box, number)
            senders = {uav for batch in frames if batch.kind == hop.label for uav in batch.source.tolist()}
            received = box.receivers(number) & awake
            if hop.role == "agent" and (account := self._accounts.get(number)) is not None:
                account.waits |= bool(received[self._waiting].any())
                account.fails |= bool(received[self._failed].any())
            if hop.is_local:
                isolated = int(np.count_nonzero((awake & ~received)[hop.senders]))
                received[self._failed] = received[self._waiting] = False
                averaging = int(np.count_nonzero(received[hop.senders]))
                self.isolated += isolated
                found: dict[str, int | None] = {"averaging": averaging, "isolated": isolated}
                ended.append(self._end(hop, number, tick, awake, has_leader, averaging, **found))
            elif hop.is_last:
                used = links[links[:, LinkColumn.KIND] == hop.label]
                reached = int((used[:, LinkColumn.DELIVERED] > 0)[awake[used[:, LinkColumn.TARGET]]].sum())
                found = {"fragments": hop.codec.count, "reached": None if self._schedule.spreads else reached}
                ended.append(self._end(hop, number, tick, awake, has_leader, len(senders), **found))
            else:
                used = links[links[:, LinkColumn.KIND] == hop.label]
                lost = set(used[used[:, LinkColumn.DELIVERED] == 0, LinkColumn.SOURCE].tolist())
                for uav in hop.senders.tolist():
                    if uav in lost or (box.addressed[uav] and uav not in senders):
                        reason = "its relay is lost" if uav in lost else "its head is silent"
                        if uav in self._waiting:
                            reason = "its aggregation rule waits for more models"
                        elif uav in self._failed:
                            reason = "its aggregation rule failed"
                        note(ClusterLeftOut(tick, number, uav, reason))
            box.close(number)
        self._refused.clear()
        self._has_failed = False
        self._verdict = RuleVerdict()
        return ended

    @property
    def transmissions(self) -> list[list[Any]]:
        """The models in fragments that are being transmitted."""
        return [one.fields() for one in self._transmissions]

    @transmissions.setter
    def transmissions(self, stored: list[list[Any]]) -> None:
        self._transmissions = [Transmission.of_fields(fields, self._hops) for fields in stored]

    @property
    def accounts(self) -> list[tuple[int, Any]]:
        """Number and account of each round that is open."""
        return list(self._accounts.items())

    @accounts.setter
    def accounts(self, stored: list[tuple[int, Any]]) -> None:
        self._accounts = {number: msgspec.convert(fields, Account) for number, fields in stored}

    def _other(self, awake: Mask, number: int) -> Mask:
        """The UAVs among the nodes that are awake (N + B,), without the one that averages a round for all."""
        others = np.zeros_like(awake)
        others[self._members] = awake[self._members]
        others[self._plan.senders(self._hops[-1], number)] = False
        return others

    def _hop(self, label: FrameKind, tick: int) -> Hop | None:
        """The hop of a label that transmits in this tick."""
        return next(
            (hop for hop in self._hops if hop.label == label and not hop.is_local and self._schedule.number(hop, tick)),
            None,
        )

    def _open_accounts(self, tick: int, frames: Iterable[Frames], awake: NDArray[np.bool_]) -> None:
        """Counts who sends in the rounds that open in this tick, and who is silent."""
        for hop in self._hops:
            if hop.mail is None and not self.is_done and (number := self._schedule.number(hop, tick)):
                sent = [uav for batch in frames if batch.kind == hop.label for uav in distinct(batch.source).tolist()]
                participants = self._schedule.participants(number)
                present = int(awake[participants].sum())
                self.silent += present - len(sent)
                self._accounts[number] = Account(len(participants), len(participants) - present, sorted(sent))

    def _follow(self, tick: int, on_air: Iterable[Frames], links: NDArray[np.int32]) -> None:
        """Counts the uploads on the air in this tick; those that arrive after their round is averaged are late."""
        for one in self._transmissions:
            one.follow(links)
        for batch in on_air:
            is_again = (batch.kind, batch.round) in self._again
            if self._schedule.spreads and batch.kind == self._hops[-1].label and not is_again:
                self._reception.send(batch)
            account = self._accounts.get(batch.round)
            after = self._uploads.get(batch.kind, 0)
            if account is None or (age := self._schedule.age(batch.round, tick)) >= after:
                continue
            count = np.bincount(batch.source, minlength=self._scenario.nodes)
            used = links[(links[:, LinkColumn.KIND] == batch.kind) & (count[links[:, LinkColumn.SOURCE]] > 0)]
            rows = count[used[:, LinkColumn.SOURCE]]
            spent = used[:, LinkColumn.WAITED] + used[:, LinkColumn.SLOTS] // rows
            ticks = age + self._scenario.delivery_ticks(spent)
            is_late = (ticks > after) & (used[:, LinkColumn.DELIVERED] > 0)
            account.transmit(used, rows * (not is_again), ticks, is_late)

    def _receive(self, hop: Hop, box: Mailbox, number: int) -> None:
        """Counts the uploads that are averaged in a hop."""
        account = self._accounts.get(number)
        if account is not None and hop.mail is not None and hop.mail.mail is None:
            account.receive(*box.arrived(number))
            account.earlier += len(box.arrived(number - 1)[0])
            account.refused |= self._refused

    def _end(
        self, hop: Hop, number: int, tick: int, awake: Mask, has_leader: bool, averaged: int, **found: Any
    ) -> RoundEnded:
        """Counts a round that ends.

        Args:
            averaged: number of UAVs that averaged in it. found: further fields of the round.
        """
        account = self._accounts.pop(number, Account(0, 0, []))
        received = account.received
        seat = self._plan.seat(number)
        has_others = bool(received - account.refused - {seat})
        leads, is_awake = hop.role == "leader", bool(awake[self._plan.senders(hop, number)].any())
        has_failed = account.fails or (leads and self._has_failed)
        waits = account.waits or (leads and hop.averages == "models" and has_others and not has_failed)
        outcome: Literal["averaged", "waiting", "void"] = "void"
        reason = ""
        if averaged or (leads and self._verdict.is_done and not has_failed):
            self.rounds += 1
            self._averaged = number
            outcome = "averaged"
        elif waits and (not leads or (is_awake and has_leader)):
            outcome = "waiting"
        else:
            self.rounds_void += 1
            reason = "no model of another UAV was averaged"
            if leads and not is_awake:
                reason = f"{name_of(self._scenario, seat)}, which averages, is lost or paused"
            elif leads and not has_leader:
                reason = "there is no leader"
            elif has_others and has_failed:
                reason = "the aggregation rule failed"
        receiver, copy = self._terms
        if receiver is not None and self._hops[0].seats is not None:
            receiver = seat
        station = None if receiver is None or receiver < self._scenario.uavs else receiver - self._scenario.uavs
        return RoundEnded(
            tick,
            number,
            number * self._schedule.period,
            outcome,
            reason,
            participants=account.participants,
            absent=account.absent,
            sent=tuple(account.sent),
            received=tuple(sorted(received)),
            late=tuple(sorted(account.late - received)),
            refused=tuple(sorted(account.refused)),
            receiver=receiver if station is None else None,
            station=station,
            copies=account.copies,
            arrived=account.arrived,
            copy=copy,
            earlier=account.earlier,
            retries=account.retries,
            shares=tuple(parts / self._hops[0].codec.count for parts in account.parts),
            delays_s=tuple(self._delay_s(*upload) for upload in zip(account.ticks, account.parts, strict=True)),
            metrics=self._verdict.metrics if leads else {},
            **found,
        )

    def _delay_s(self, ticks: int, parts: int) -> float | None:
        """Time after the opening at which the last part of an upload arrived, s; None if nothing did."""
        if ticks < 0:
            return 0.0 if parts else None  # by no radio
        return ticks * self._scenario.dt

    @cached_property
    def _terms(self) -> tuple[int | None, str]:
        """The receiver of the uploads, if it is one UAV, and the name of their copies, if an upload has several."""
        upload = next(hop for hop in self._hops if hop.mail is None)
        targets = [] if upload.targets is None else np.unique(upload.targets[upload.senders]).tolist()
        copies = "fragments" if upload.codec.count > 1 else "" if targets else "copies"
        return targets[0] if len(targets) == 1 else None, copies
