"""Guard of a node's controller: an exception or an invalid result of one row breaks that row and no other.

The controller may be foreign code. If a check of its results fails for all rows together, it is repeated row by row.
"""

import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from meanflock.agent.controllers.base import Arrival, Broadcast, Controller, Memory, Received, Rows, Step
from meanflock.agent.step_checks import check_notes, checked_step
from meanflock.federation.codec import carried_weights, check_weights
from meanflock.federation.cut import bound_of_models
from meanflock.swarm.declared import Declared, controller
from meanflock.swarm.errors import FAILURES, BadInput, last_line, plugin_line
from meanflock.swarm.events.base import listed
from meanflock.swarm.events.nodes import FailedController, Problem
from meanflock.swarm.plugins.guard import as_floats, bounded_rows, check_bounded, check_memory, check_same_form
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import BEYOND_SENSE, Floats, Mask, distinct
from meanflock.swarm.wire.messages import NOBODY

Answer = TypeVar("Answer")


class TableCheck(NamedTuple):
    """Check of a table with a row for each UAV.

    refuse: raises ValueError if a number is invalid; the text names the table. valid: mask (M,) of the valid rows.
    """

    refuse: Callable[[str, Floats], None]
    valid: Callable[[Floats], Mask]


BOUNDED, WEIGHTS = TableCheck(check_bounded, bounded_rows), TableCheck(check_weights, carried_weights)

_TRIED = 64  # rows with invalid numbers that are asked alone; if each is invalid again, the others are not asked

log = logging.getLogger("meanflock.agent")


class Guarded:
    """The controller of a node's rows. If a call fails for all rows together, it is repeated for each row alone.

    broken: mask (M,) of the rows in which it failed since `begin`; None for none.
    asleep: mask (M,), as given to `begin`.
    controller: the controller, behind its filter.
    """

    def __init__(self, scenario: Scenario, declared: Declared, uavs: Rows, problems: list[Problem]) -> None:
        """
        Args:
            scenario: as the controller gets it. declared: its declarations.
            problems: a list that gets each row in which the controller failed, once, and its news.

        Raises:
            BadInput: the controller is not installed, or its options do not fit.
        """
        self.broken: Mask | None = None
        self._method, self._declared = scenario.method, declared
        self._blank = np.zeros((len(uavs), scenario.dimensions + len(self._declared.diagnostics)))  # commands
        self._uavs = uavs
        self._everyone = scenario.uavs
        self._problems = problems
        self.controller: Controller = controller(scenario)
        self._reported = np.zeros(len(uavs), dtype=bool)  # rows that had a complaint
        self._warned = False
        self.asleep: Mask | None = None
        most = bound_of_models(scenario)
        self._models = TableCheck(partial(check_bounded, most=most), partial(bounded_rows, most=most))

    def begin(self, asleep: Mask | None) -> None:
        """Begin a tick. `asleep`: mask (M,) of rows whose results are dropped, so that they cannot fail."""
        self.broken, self.asleep = None, asleep

    def or_broken(self, rows: Mask) -> Mask:
        """Mask (M,) of `rows` and of the broken rows."""
        return rows if self.broken is None else rows | self.broken

    def init(self, plan: Floats) -> Memory:
        """See `Controller.init`.

        Raises:
            BadInput: it failed.
        """
        try:
            return self._initial_memory(self._uavs, plan)
        except FAILURES as error:
            _, errors = _each_row(
                range(len(self._uavs)), lambda row: self._initial_memory(self._uavs[row : row + 1], plan)
            )
            failed = [self._uavs[row] for row in errors] or self._uavs
            uavs = listed(tuple(failed))
            raise BadInput(f"controller {self._method!r} failed in `init` with {uavs}: {last_line(error)}") from error

    def _initial_memory(self, uavs: Rows, plan: Floats) -> Memory:
        memory = self.controller.init(uavs.copy(), plan)
        check_memory("memory", memory, len(uavs))
        return memory

    def step(self, memory: Memory, tick: int, own: Floats, received: Sequence[Received]) -> tuple[Step, Floats, float]:
        """The step of all rows, their commands (M, 2 + K), and the largest |number| of these.

        Commands of rows in which the controller fails are NaN, and then so is the largest number.
        """
        try:
            step = self.controller.step(memory, tick, own, received)
            commands, largest = checked_step(step, memory, self._blank, self._declared, self._everyone)
            self._problems += step.news
            return step, commands, largest
        except FAILURES as error:
            step, commands, errors = self._step_rows(memory, tick, own, received)
            self._break(errors)
            if not errors:
                self._warn_of_rows(error)
            return step, commands, float(np.abs(commands).max(initial=0.0))

    def get(self, memory: Memory, rows: Rows) -> Floats:
        """The models (M, parameters). Only `rows` are needed, so only they can fail."""
        return self._table("get", memory, (self._declared.parameters,), rows.tolist(), self._models)

    def samples(self, memory: Memory, rows: Rows) -> Floats:
        """The weights of the models (M,); a radio can carry those of `rows` that are not broken."""
        return self._table("samples", memory, (), rows.tolist(), WEIGHTS)

    def ready(self, memory: Memory, rows: Rows) -> Mask:
        """Mask (M,) of the rows that have a model to upload."""
        return self._table("ready", memory, (), rows.tolist()) != 0.0

    def based(self, memory: Memory, rows: Rows) -> NDArray[np.intp] | None:
        """The rounds (M,) of the global models from which the training of the models began; None: see `Controller`."""
        with suppress(*FAILURES):  # below it fails for its rows
            if self.controller.based(memory) is None:
                return None
        return self._table("based", memory, (), rows.tolist()).astype(np.intp)

    def notes(self, memory: Memory, rows: Rows) -> list[bytes]:
        """The notes of some rows; empty ones if the controller declares none or fails."""
        if not self._declared.note_bytes:
            return [b""] * len(rows)

        def checked(memory: Memory, rows: int) -> Sequence[bytes]:
            notes = self.controller.note(memory)
            check_notes(notes, rows, self._declared.note_bytes)
            return notes

        try:
            notes = checked(memory, len(self._uavs))
        except FAILURES:
            by_row, errors = _each_row(rows.tolist(), lambda row: checked(_row(memory, row), 1)[0])
            self._break(errors)
            return [by_row.get(row, b"") for row in rows.tolist()]
        return [notes[row] for row in rows.tolist()]

    def report(self, memory: Memory) -> Floats:
        """The learned weights, (M, weights)."""
        return self._table("report", memory, (self._declared.weights,), range(len(self._uavs)))

    def arrived(self, memory: Memory, rows: Rows, arrival: Arrival) -> Memory:
        """The memory after a global model has reached some rows."""
        return self._told("set", self.controller.arrived, memory, rows, arrival, arrival.row)

    def guided(self, memory: Memory, rows: Rows, goals: Floats) -> Memory:
        """The memory after some rows were given other goals, (len(rows), d)."""
        return self._told("guide", self.controller.guide, memory, rows, goals, lambda place: goals[place : place + 1])

    def _told(
        self,
        method: str,
        call: Callable[[Memory, Rows, Any], Memory],
        memory: Memory,
        rows: Rows,
        news: Any,
        alone: Callable[[int], Any],
    ) -> Memory:
        """The memory after some rows were told news, by a method of the controller.

        Args:
            method: its name, for an error.
            alone: the news for the row at a place among `rows`, as if it were alone.
        """

        def after(memory: Memory, rows: Rows, news: Any) -> Memory:
            changed = call(memory, rows, news)
            check_same_form(f"`{method}`: memory", changed, memory)
            return changed

        try:
            return after(memory, rows, news)
        except FAILURES:
            places = {row: place for place, row in enumerate(rows.tolist())}
            first = np.zeros(1, dtype=np.intp)
            by_row, errors = _each_row(places, lambda row: after(_row(memory, row), first, alone(places[row])))
            self._break(errors)
            return _with_rows(memory, by_row)

    def break_not_finite(self, memory: Memory) -> None:
        """Break the rows whose memory has numbers that are not finite, so that no checkpoint stores them."""
        for name, array in memory.items():
            bad = np.flatnonzero((~np.isfinite(array)).reshape(len(array), -1).any(axis=1))
            if len(bad):
                error = ValueError(f"memory[{name!r}] has numbers that are not finite")
                self._break(dict.fromkeys(bad.tolist(), error))

    def note_beyond(self, commands: Floats, rows: Mask) -> None:
        """Complain of `rows` (M,) whose commands (M, 2 + K) are beyond all bounds, and name a number of each.

        Rows that are broken already had their complaint.
        """
        axes = "xyz"[: commands.shape[1] - len(self._declared.diagnostics)]
        names = (*(f"acceleration along {axis}" for axis in axes), *self._declared.diagnostics)
        fresh = np.flatnonzero(rows & ~self._reported)
        columns = (~(np.abs(commands[fresh]) < BEYOND_SENSE)).argmax(axis=1)
        numbers = commands[fresh, columns].tolist()
        found = zip(fresh.tolist(), columns.tolist(), numbers, strict=True)
        self._report_problems({row: f"its {names[column]} is {number:g}" for row, column, number in found})

    def _step_rows(
        self, memory: Memory, tick: int, own: Floats, received: Sequence[Received]
    ) -> tuple[Step, Floats, dict[int, BaseException]]:
        """The steps of all rows, each alone, and the errors of those that fail. A row that fails keeps its memory, and
        its commands are NaN."""
        columns = self._blank.shape[1]
        axes = columns - len(self._declared.diagnostics)
        commands = np.full((len(own), columns), np.nan)
        sent: dict[int, dict[int, NDArray[np.generic]]] = {}  # payloads by number of the broadcast, then by row

        def step_row(row: int) -> Step:
            single = _row(memory, row)
            step = self.controller.step(single, tick, own[row : row + 1], received_by(received, row))
            numbers, _ = checked_step(step, single, np.zeros((1, columns)), self._declared, self._everyone)
            payloads = {number: broadcast.payload for number, broadcast in enumerate(step.broadcasts)}
            for number, payload in payloads.items():
                first = next(iter(sent.get(number, {}).values()), payload)
                if len(payload) and (payload.shape, payload.dtype) != (first.shape, first.dtype):
                    raise ValueError(f"broadcast {number} is unlike that of other rows")
            for number, payload in payloads.items():
                # Also without senders: the position in the tuple is the number of the broadcast.
                by_row = sent.setdefault(number, {})
                if len(payload):
                    by_row[row] = payload
            commands[row] = numbers
            return step

        steps, errors = _each_row(range(len(own)), step_row)
        self._problems += [one for step in steps.values() for one in step.news]
        silence = [np.zeros((0, 1))]
        broadcasts = tuple(
            Broadcast(np.concatenate([*payloads.values()] or silence), np.array([*payloads], dtype=np.intp))
            for _, payloads in sorted(sent.items())
        )
        after = _with_rows(memory, {row: step.memory for row, step in steps.items()})
        refused = distinct(np.concatenate([NOBODY, *(step.refused for step in steps.values())])).astype(np.int32)
        return Step(after, commands[:, :axes], commands[:, axes:], broadcasts, refused), commands, errors

    def _table(
        self, name: str, memory: Memory, width: tuple[int, ...], asked: Iterable[int], check: TableCheck = BOUNDED
    ) -> Floats:
        call, rows, label = getattr(self.controller, name), len(self._uavs), f"result of `{name}`"

        def called(memory: Memory, rows: int) -> Floats:
            return np.ascontiguousarray(as_floats(label, call(memory), (rows, *width)))

        def alone(row: int) -> Floats:
            table = called(_row(memory, row), 1)
            check.refuse(label, table)
            return table

        table: Floats | None = None
        try:
            table = called(memory, rows)
            check.refuse(label, table)
            return table
        except FAILURES as error:
            failed = np.ones(rows, dtype=bool) if table is None else ~check.valid(table)
            doubted, tried = np.flatnonzero(failed).tolist(), rows if table is None else _TRIED
            by_row, errors = _each_row(doubted[:tried], alone)
            if by_row:  # a bad row has spoiled others
                others, errors_of_others = _each_row(doubted[tried:], alone)
                by_row, errors = by_row | others, errors | errors_of_others
            answer = np.zeros((rows, *width))
            if table is not None:
                np.copyto(answer, table, where=~failed.reshape(-1, *(1,) * len(width)))
            for row, single in by_row.items():
                answer[row], failed[row] = single[0], False
            self._break({row: errors.get(row, error) for row in asked if failed[row]})
            return answer

    def _warn_of_rows(self, error: BaseException) -> None:
        """Log the first step that failed for all rows together, and for none alone."""
        if not self._warned:
            self._warned = True
            log.warning(
                "controller %r failed for %d UAVs together and for none alone; each is stepped alone then, which is "
                "slow: %s",
                self._method,
                len(self._uavs),
                last_line(error),
            )

    def _break(self, errors: Mapping[int, BaseException]) -> None:
        """Mark rows as broken, and complain of those that had no complaint. Log the error of the first of these."""
        broken = np.zeros(len(self._uavs), dtype=bool)
        broken[[*errors]] = True
        if self.asleep is not None:
            broken = broken & ~self.asleep
        self.broken = self.or_broken(broken)
        if (fresh := broken & ~self._reported).any():
            error = errors[int(fresh.argmax())]
            # Lines of the plug-in. A `sys.exit()` needs no trace, nor does an answer that is refused here.
            trace = error if isinstance(error, Exception) and plugin_line(error) else None
            log.warning("controller %r failed: %s", self._method, last_line(error), exc_info=trace)
            different = {id(each): each for each in errors.values()}  # thousands of rows may share an error
            reasons = {name: last_line(each) for name, each in different.items()}
            self._report_problems({row: reasons[id(errors[row])] for row in np.flatnonzero(fresh).tolist()})

    def _report_problems(self, reasons: Mapping[int, str]) -> None:
        """Report rows that had no complaint: those of each reason together."""
        uavs: dict[str, list[int]] = {}
        for row, reason in reasons.items():
            uavs.setdefault(reason, []).append(int(self._uavs[row]))
        self._reported[[*reasons]] = True
        self._problems += [FailedController(tuple(named), reason) for reason, named in uavs.items()]


def choose(mask: Mask, chosen: Memory, others: Memory) -> Memory:
    """The rows `mask` (M,) of the memory `chosen`, all others of the memory `others`."""
    return others | {
        name: np.where(mask.reshape(-1, *(1,) * (array.ndim - 1)), chosen[name], array)
        for name, array in others.items()
        if chosen.get(name, array) is not array
    }


def _row(memory: Memory, row: int) -> Memory:
    """The memory of one row alone."""
    return {name: array[row : row + 1] for name, array in memory.items()}


def received_by(received: Sequence[Received], row: int) -> tuple[Received, ...]:
    """The frames that one row received, as if it were alone."""
    own = []
    for frames in received:
        mine = frames.links[frames.links[:, 1] == row]
        if len(mine):
            used, place = np.unique(mine[:, 0], return_inverse=True)
            links = np.stack([place, np.zeros_like(place)], axis=-1)
            own.append(Received(frames.number, frames.source[used], frames.payload[used], links))
    return tuple(own)


def _each_row(rows: Iterable[int], ask: Callable[[int], Answer]) -> tuple[dict[int, Answer], dict[int, BaseException]]:
    """Results of a call for each row alone, and the errors of the rows in which it fails."""
    answers: dict[int, Answer] = {}
    errors: dict[int, BaseException] = {}
    for row in rows:
        try:
            answers[row] = ask(row)
        except FAILURES as error:
            error.__suppress_context__ = True  # the error of all rows together
            errors[row] = error
    return answers, errors


def _with_rows(memory: Memory, memories: Mapping[int, Memory]) -> Memory:
    """A copy of a memory in which some rows have memories of their own."""
    after = {name: array.copy() for name, array in memory.items()}
    for row, single in memories.items():
        for name, array in single.items():
            after[name][row] = array[0]
    return after
