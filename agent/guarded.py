"""A controller, which may be anybody's: what it raises, or cannot mean, costs its own rows and no others."""

import logging
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from meanflock.agent.controllers.base import Controller, Memory, Received, Step
from meanflock.agent.rows import (
    checked_step,
    checked_table,
    each_alone,
    put,
    row_of,
    step_each_alone,
)
from meanflock.swarm import state
from meanflock.swarm.declared import controller
from meanflock.swarm.errors import BadInput
from meanflock.swarm.failures import FAILURES, last_line
from meanflock.swarm.kept import check_again, check_kept
from meanflock.swarm.model import BEYOND_SENSE
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats, Mask

Rows = NDArray[np.intp]

log = logging.getLogger("meanflock.agent")


class Guarded:
    """The controller of a node's rows. Where a call fails for all of them together, every row is asked alone.

    broken: (M,), the rows in which it has failed since `begin`; None for none. asleep: (M,), as `begin` was told.
    """

    def __init__(self, scenario: Scenario, uavs: Rows, complaints: list[str]) -> None:
        """`complaints`: where it is said, once of each row, that the controller has failed.

        Raises:
            BadInput: there is no such controller, or its options do not fit.
        """
        self.broken: Mask | None = None
        self._method, self._declared = scenario.method, scenario.declared
        self._blank = np.zeros((len(uavs), state.AXES + len(self._declared.diagnostics)))  # commands
        self._uavs, self._everyone, self._complaints = uavs, scenario.uavs, complaints
        self._controller: Controller = controller(scenario)
        self._known = np.zeros(len(uavs), dtype=bool)  # who has been complained of
        self.asleep: Mask | None = None

    def begin(self, asleep: Mask | None) -> None:
        """A tick begins; `asleep`: (M,), rows that are not really asked, and do not fail."""
        self.broken, self.asleep = None, asleep

    def or_broken(self, rows: Mask) -> Mask:
        """`rows` (M,) and those that are broken."""
        return rows if self.broken is None else rows | self.broken

    def init(self, plan: Floats) -> Memory:
        """See `Controller.init`.

        Raises:
            BadInput: it failed.
        """
        try:
            return self._begun(self._uavs, plan)
        except FAILURES as error:
            alone = each_alone(range(len(self._uavs)), lambda row: self._begun(self._uavs[row : row + 1], plan))
            failed = [uav for row, uav in enumerate(self._uavs) if row not in alone] or self._uavs
            uavs = ", ".join(map(str, failed))
            raise BadInput(
                f"controller {self._method!r} failed in `init` with UAV {uavs}: {last_line(error)}"
            ) from error

    def _begun(self, uavs: Rows, plan: Floats) -> Memory:
        memory = self._controller.init(uavs.copy(), plan)
        check_kept("memory", memory, len(uavs))
        return memory

    def step(self, memory: Memory, tick: int, own: Floats, received: Sequence[Received]) -> tuple[Step, Floats, float]:
        """The step of all rows, their commands (M, 2 + K), and the largest |number| of these: of rows in which the
        controller fails they are NaN, and so is it.
        """
        try:
            step = self._controller.step(memory, tick, own, received)
            return step, *checked_step(step, memory, self._blank, self._declared, self._everyone)
        except FAILURES as error:
            asked = self._controller, memory, tick, own, received
            step, commands = step_each_alone(*asked, self._declared, self._everyone)
            self._break(np.flatnonzero(np.isnan(commands).any(axis=-1)), error)
            return step, commands, float(np.abs(commands).max(initial=0.0))

    def get(self, memory: Memory, rows: Rows) -> Floats:
        """The models (M, parameters); only `rows` are asked for, and can fail."""
        return self._table("get", memory, self._declared.parameters, rows.tolist())

    def report(self, memory: Memory) -> Floats:
        """What was learned, (M, weights)."""
        return self._table("report", memory, self._declared.weights, range(len(self._uavs)))

    def set(self, memory: Memory, rows: Rows, models: Floats) -> Memory:
        """The memory after some rows were given a global model (len(rows), parameters)."""
        try:
            after = self._controller.set(memory, rows, models)
            check_again("memory", after, memory)
            return after
        except FAILURES as error:
            places = {row: slice(place, place + 1) for place, row in enumerate(rows.tolist())}
            alone = each_alone(places, lambda row: self._taught(row_of(memory, row), models[places[row]]))
            self._break([row for row in places if row not in alone], error)
            return put(memory, alone)

    def look(self, memory: Memory) -> None:
        """Before a checkpoint: what a row remembers must be finite, or nobody could go on from it."""
        for name, array in memory.items():
            bad = np.flatnonzero((~np.isfinite(array)).reshape(len(array), -1).any(axis=1))
            if len(bad):
                self._break(bad, ValueError(f"memory[{name!r}] has numbers that are not finite"))

    def note_beyond(self, commands: Floats, rows: Mask) -> None:
        """Takes note of `rows` (M,) whose commands (M, 2 + K) have left all bounds, and says which number of the first
        of them it was. Of those that are broken it is known why.
        """
        rows = rows & ~self._known
        if not rows.any():
            return
        first = commands[np.flatnonzero(rows)[0]]
        column = int(np.flatnonzero(~(np.abs(first) < BEYOND_SENSE))[0])
        name = ("acceleration along x", "acceleration along y", *self._declared.diagnostics)[column]
        self._complain(rows, f"its {name} is {first[column]:g}")

    def _taught(self, alone: Memory, model: Floats) -> Memory:
        after = self._controller.set(alone, np.zeros(1, dtype=np.intp), model)
        check_again("memory", after, alone)
        return after

    def _table(self, name: str, memory: Memory, width: int, asked: Iterable[int]) -> Floats:
        call, rows = getattr(self._controller, name), len(self._uavs)
        try:
            return checked_table(name, call(memory), rows, width)
        except FAILURES as error:
            alone = each_alone(range(rows), lambda row: checked_table(name, call(row_of(memory, row)), 1, width))
            self._break([row for row in asked if row not in alone], error)
            return np.concatenate([alone.get(row, np.zeros((1, width))) for row in range(rows)])

    def _break(self, rows: Rows | list[int], error: BaseException) -> None:
        """Takes note of rows in which it has failed."""
        broken = np.zeros(len(self._uavs), dtype=bool)
        broken[rows] = True
        if self.asleep is not None:
            broken = broken & ~self.asleep
        self.broken = self.or_broken(broken)
        if (unheard := broken & ~self._known).any():
            trace = error if isinstance(error, Exception) else None  # there is no defect to find in a `sys.exit()`
            log.warning("controller %r failed: %s", self._method, last_line(error), exc_info=trace)
            self._complain(unheard, last_line(error))

    def _complain(self, rows: Mask, why: str) -> None:
        """Once of every row."""
        self._known = self._known | rows
        names = ", ".join(map(str, self._uavs[rows]))
        self._complaints.append(f"controller {self._method!r} failed with UAV {names}: {why}")
