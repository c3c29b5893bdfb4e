"""The agent node: flies M UAVs, the rows of its arrays, by the controller of the scenario."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from meanflock.agent.controllers.base import Arrival, Broadcast, Controller, Received
from meanflock.agent.guarded import Guarded, choose
from meanflock.federation.groups import group_number
from meanflock.federation.plan import plan_of
from meanflock.federation.rounds import Rounds
from meanflock.swarm import faults, mission
from meanflock.swarm.declared import MEMORY_TICKS, PRESENT, most_memory
from meanflock.swarm.errors import BadInput, MessageRejected
from meanflock.swarm.events.base import listed
from meanflock.swarm.events.nodes import Problem
from meanflock.swarm.scenario import decode
from meanflock.swarm.state import BEYOND_SENSE, Floats, Mask, contains, distinct
from meanflock.swarm.wire.control import FLOAT_OF_BITS, decode_record, encode_record, expect
from meanflock.swarm.wire.messages import NOBODY, Act, FrameKind, Frames, Sense, Welcome


class Agent:
    """Answers each Sense with an Act; the client that carries the messages calls `act`."""

    def __init__(self, welcome: Welcome) -> None:
        """Raises BadInput if the controller cannot be made or its `init` fails."""
        self.uavs = np.array(welcome.uavs, dtype=np.intp)
        self.problems: list[Problem] = []  # for the world, not sent yet
        self._names = self.uavs.astype(np.int32)  # as frames have them
        plan = plan_of(decode(welcome.scenario))
        self._scenario = plan.scenario
        group = plan.groups[group_number(plan.groups, self.uavs)]
        self._declared = group.declared
        self._hears = group.hears
        self._reports = group.declared.weights == plan.declared.weights > 0 and (group.takes_part or not plan.hops)
        self._columns = len(plan.declared.diagnostics) if len(plan.groups) > 1 else None
        self._places = [self._scenario.dimensions + place for place in plan.places(group)]
        self._float = FLOAT_OF_BITS[self._scenario.radio.bits_per_float]
        self._rounds = Rounds(plan, "agent", self.uavs, self.problems, self)
        self._row = np.full(self._scenario.nodes, -1)  # (N + B,) of each UAV that is here
        self._row[self.uavs] = np.arange(len(self.uavs))
        self._failed = np.zeros(len(self.uavs), dtype=bool)
        self._any_failed = False
        self._joins, self._leaves = mission.joins(self._scenario)[self.uavs], mission.leaves(self._scenario)[self.uavs]
        self._pauses = any(isinstance(fault, faults.Pause) for fault in self._scenario.faults) or bool(
            self._joins.any() or (self._leaves < mission.NEVER).any()
        )
        starts = expect(
            "initial_states", welcome.initial_states, (self._scenario.uavs, self._scenario.state_numbers), self._float
        )
        self._controller = Guarded(group.scenario, group.declared, self.uavs, self.problems)
        self._memory = self._controller.init(starts.astype(np.float64))
        if welcome.memory:
            self._resume(welcome.memory)

    @property
    def controller(self) -> Controller:
        """The controller, behind its filter if there is one."""
        return self._controller.controller

    @property
    def models(self) -> Floats:
        """The learned weights of each row, `(M, W)`."""
        return self._controller.report(self._memory) if self._reports else np.zeros((len(self.uavs), 0))

    def act(self, sense: Sense) -> Act:
        """Compute one tick. The reader of the Sense has checked that it has the states of this node's UAVs.

        Raises:
            MessageRejected: a frame in it does not fit this node; nothing has changed.
        """
        return self.reply(sense, self.hear(sense))

    def hear(self, sense: Sense) -> tuple[Received, ...]:
        """Begin a tick: the rounds take models, and rows other goals. Returns the frames of other UAVs.

        Raises:
            MessageRejected: a frame in it does not fit this node; nothing has changed.
        """
        before = self._memory
        goals = self._goals_in(sense.memory) if sense.memory else None
        received = self._receive(sense)
        if goals is not None:
            self._memory = self._controller.guided(self._memory, *goals)
        if self._controller.asleep is not None and self._memory is not before:
            self._memory = choose(self._controller.asleep, before, self._memory)
        return received

    def reply(self, sense: Sense, received: tuple[Received, ...]) -> Act:
        """Compute the rest of a tick, in which the frames `received` were heard."""
        tick = sense.tick
        before, controller = self._memory, self._controller
        # 1. Take part in the rounds.
        outbox, refused = self._rounds.act(tick)
        waiting = self._rounds.waiting
        # 2. Let the controller fly.
        step, commands, largest = controller.step(self._memory, tick, sense.states, received)
        self._memory = step.memory
        # 3. Rows that the fault script pauses get their old memory back.
        if controller.asleep is not None:
            commands[controller.asleep] = 0.0
            self._memory = choose(controller.asleep, before, self._memory)
        # 4. A row with a diverged number is reported and sends nothing; the other rows continue.
        if tick % MEMORY_TICKS == 0:  # whether or not a checkpoint is due: flights with and without them are the same
            controller.break_not_finite(self._memory)
        learned = controller.report(self._memory) if sense.report and self._reports else None
        if controller.broken is not None:
            commands[controller.broken] = np.nan
        if self._any_failed or controller.broken is not None or not largest < BEYOND_SENSE:  # NaN is below nothing
            self._silence(commands)
            if learned is not None:
                learned = np.where(self._failed[:, None], 0.0, learned)
        if self._columns is not None:
            commands = self._widened(commands)
        for number, broadcast in enumerate(step.broadcasts):
            outbox += self._frames_of(number, broadcast)
        if not (sense.report or sense.checkpoint or refused or waiting or self._any_failed or len(step.refused)):
            return Act(sense.run, tick, commands, outbox=tuple(outbox))
        return Act(
            sense.run,
            tick,
            commands,
            self._names[self._failed],
            np.array(refused, np.int32),
            self._others(step.refused),
            np.array(waiting, np.int32),
            learned,
            self._memory_record() if sense.checkpoint else b"",
            tuple(outbox),
        )

    def _others(self, refused: NDArray[np.integer]) -> NDArray[np.int32]:
        """Refused UAVs, each once. A node of one UAV does not refuse itself; a node of several may refuse its own."""
        found = distinct(refused).astype(np.int32)
        return found if len(self.uavs) > 1 else found[found != self._names[0]]

    def _widened(self, commands: Floats) -> Floats:
        """Commands (M, 2 + K) with the diagnostics of all groups, 0 in those of others."""
        axes = self._scenario.dimensions
        wide = np.zeros((len(commands), axes + (self._columns or 0)))
        wide[:, :axes] = commands[:, :axes]
        wide[:, self._places] = commands[:, axes:]
        return wide

    # -- what goes out ------------------------------------------------------------------------------------------

    def _silence(self, commands: Floats) -> None:
        """Mark rows with diverged commands as failed; set commands and memory of all failed rows to zero."""
        beyond = ~np.all(np.abs(commands) < BEYOND_SENSE, axis=-1)
        self._controller.note_beyond(commands, beyond & ~self._failed)
        self._failed = self._failed | beyond
        self._any_failed = bool(self._failed.any())
        commands[self._failed] = 0.0
        nothing = {name: np.zeros_like(array) for name, array in self._memory.items()}
        self._memory = choose(self._failed, nothing, self._memory)

    def _frames_of(self, number: int, broadcast: Broadcast) -> list[Frames]:
        """The frames of a broadcast, with floats of the radio. Rows that fail or exceed these floats send none."""
        payload, rows = broadcast.payload, broadcast.rows
        names = self._names if rows is None else self._names[rows]
        failed = None if not self._any_failed else self._failed if rows is None else self._failed[rows]
        if payload.dtype.kind == "f":
            with np.errstate(over="ignore"):
                payload = payload.astype(self._float)  # infinite beyond the range of the radio's floats
            fits = np.isfinite(payload).all(axis=-1)
            if not fits.all():
                failed = ~fits if failed is None else failed | ~fits
        else:
            payload = payload.copy()  # the controller may write to its own
        if failed is not None:
            names, payload = names[~failed], payload[~failed]
        payload.flags.writeable = False  # all receivers of this process share it
        return [Frames(FrameKind.STATE, number, names, payload)] if len(names) else []

    # -- what comes in ------------------------------------------------------------------------------------------

    def _receive(self, sense: Sense) -> tuple[Received, ...]:
        """Give models to the rounds; returns the frames of other UAVs.

        Raises:
            MessageRejected: a frame does not fit this node; nothing has changed.
        """
        links = [self._links(frames) for frames in sense.inbox]
        self._controller.begin(self._paused(sense.tick) if self._pauses else None)
        if not links:
            return ()
        received = []
        for frames, pairs in zip(sense.inbox, links, strict=True):
            if frames.kind != FrameKind.STATE:
                self._rounds.receive(frames, sense.tick)
                continue
            if self._hears is not None:
                pairs = pairs[self._hears[frames.source[pairs[:, 0]]]]
                if not len(pairs):
                    continue
            payload = frames.payload.astype(np.float64) if frames.payload.dtype.kind == "f" else frames.payload
            received.append(Received(frames.round, frames.source.astype(np.intp), payload, pairs))
        return tuple(received)

    def _links(self, frames: Frames) -> NDArray[np.intp]:
        """The links of a batch as pairs (L, 2), [row of payload, row of this node]; raises MessageRejected if the batch
        does not fit this node."""
        if frames.links is None:
            raise MessageRejected("wrong-shape", "frames without links")
        links = frames.links.astype(np.intp)
        links[:, 1] = row = self._row.take(links[:, 1])
        if np.minimum.reduce(row) < 0:
            raise MessageRejected("wrong-shape", "frames for UAVs that are not here")
        if frames.kind != FrameKind.STATE:
            self._rounds.check(frames)
        elif self._scenario.stations and frames.source.max() >= self._scenario.uavs:
            raise MessageRejected("wrong-shape", "states of a station")
        return links

    def _goals_in(self, record: bytes) -> tuple[NDArray[np.intp], Floats]:
        """The rows (K,) that get another goal, and these goals (K, d), m.

        Raises:
            MessageRejected: the record does not fit this node.
        """
        told = decode_record(record)
        uavs = expect("uavs", told.get("uavs", NOBODY), (None,), np.dtype(np.intp))
        goals = expect("goals", told.get("goals", NOBODY), (len(uavs), self._scenario.dimensions), np.dtype(float))
        if not ((uavs >= 0) & (uavs < self._scenario.uavs)).all() or (self._row[uavs] < 0).any():
            raise MessageRejected("wrong-shape", "goals of UAVs that are not here")
        return self._row[uavs], goals

    # -- rounds: the methods of `NodeModels` --------------------------------------------------

    def models_to_send(self, rows: NDArray[np.intp]) -> tuple[NDArray[np.intp], Floats, Floats]:
        """The rows among these that can send, their models (S, L) and the weights of these (S,)."""
        rows = rows[~self.silent()[rows]]
        if not len(rows):
            return rows, np.zeros((0, self._declared.parameters)), np.zeros(0)
        models = self._controller.get(self._memory, rows)
        weights = self._controller.samples(self._memory, rows) if self._declared.weighted else np.ones(len(models))
        rows = rows[~self.silent()[rows]]  # `get` or `samples` may have failed for some
        if len(rows) == len(models):  # all of them, without a copy
            return rows, models, weights
        return rows, models[rows], weights[rows]

    def ready(self, rows: NDArray[np.intp]) -> NDArray[np.intp]:
        """The rows among these that have a model to upload."""
        return rows[self._controller.ready(self._memory, rows)[rows]] if len(rows) else rows

    def based(self, rows: NDArray[np.intp]) -> NDArray[np.intp] | None:
        """The rounds (S,) of the global models from which the training of the rows' models began; None: unknown."""
        based = self._controller.based(self._memory, rows)
        return None if based is None else based[rows]

    def notes(self, rows: NDArray[np.intp]) -> list[bytes]:
        """The notes that these rows send with their models."""
        return self._controller.notes(self._memory, rows)

    def take(self, rows: NDArray[np.intp], models: Floats, number: int, whole: Mask, notes: Sequence[bytes]) -> None:
        """Give some rows the global model of a round as `models` (S, L), the mask `whole` (S,) of those that got all of
        its fragments, and a note each."""
        self._memory = self._controller.arrived(self._memory, rows, Arrival(number, models, whole, notes))

    def silent(self) -> Mask:
        """Mask (M,) of the rows that send nothing in this tick: failed, paused or broken ones."""
        asleep = self._controller.asleep
        return self._controller.or_broken(self._failed if asleep is None else self._failed | asleep)

    # -- the fault script, and checkpoints ----------------------------------------------------------------------

    def _paused(self, tick: int) -> Mask | None:
        """Mask (M,) of the rows that the fault script pauses in this tick, or that are not there; None for none."""
        paused = np.array(faults.paused(self._scenario.faults, tick, self._scenario.dt), dtype=np.intp)
        asleep = contains(paused, self.uavs) | (tick < self._joins) | (tick >= self._leaves)
        return asleep if asleep.any() else None

    def _memory_record(self) -> bytes:
        """The memory of all rows, as a record; empty if it exceeds the room of a checkpoint."""
        memory = self._memory | self._rounds.state()
        size = sum(array.nbytes for array in memory.values())
        if size * self._scenario.uavs > most_memory(self._scenario.uavs) * len(self.uavs):
            return b""
        return encode_record({name: np.ascontiguousarray(array) for name, array in memory.items()})

    def _resume(self, record: bytes) -> None:
        """Continue with the memory in a record of `_memory_record`; raises BadInput if it does not fit."""
        try:
            memory = decode_record(record)
            present = memory.pop(PRESENT, None)
            self._rounds.restore(memory)
            if set(memory) != set(self._memory):
                raise MessageRejected("wrong-shape", f"a memory of {sorted(memory)}, expected {sorted(self._memory)}")
            for name, array in self._memory.items():
                self._memory[name] = expect(name, memory[name], array.shape, array.dtype).copy()
                if present is not None:
                    begun = ~expect(PRESENT, present, (len(self.uavs),), np.dtype(bool))
                    self._memory[name][begun] = array[begun]
        except MessageRejected as error:
            raise BadInput(
                f"the memory of {listed(tuple(self.uavs.tolist()))} does not fit this controller: {error}"
            ) from error
