"""Trial flight of a controller: a swarm of points with rounds, and a radio that loses some of their frames."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meanflock.agent.controllers.base import Arrival, Controller, Memory, Received, Step
from meanflock.agent.guarded import received_by
from meanflock.agent.step_checks import checked_step
from meanflock.federation.cut import bound_of_models
from meanflock.swarm import state
from meanflock.swarm.declared import declarations_of
from meanflock.swarm.errors import FAILURES, BadInput, last_line
from meanflock.swarm.mission import starts
from meanflock.swarm.plugins import guard
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import States
from meanflock.swarm.wire.control import FLOAT_OF_BITS, decode_record, encode_record
from meanflock.swarm.workers import each
from meanflock.testing.error import GONE, alike, asked, check_kept, copies, fail, same, with_surroundings

TICKS = 40  # of a controller without rounds
LONG = 205  # ticks of two rounds of a controller that declares no period
ROUNDS, AFTER = 2, 5  # rounds that a trial has at least, and ticks after the last of them
LOST = 0.2  # share of the frames that the radio loses in the trial

RANDOM = 'draw from mf.seeds.generator(seed, "controller", index), the index made of the tick and the UAV\'s number'
PURE = "return new arrays; copy before you write"
FINITE = "such a UAV is lost; guard divisions, roots and empty sums"
GET, SET = "return one row a UAV, `parameters` wide", "return the memory with `models` in its rows `rows`"


class Trial(NamedTuple):
    """Record of a trial: commands (N, 2 + K) and broadcasts of every tick, memory and models at the end."""

    commands: list[NDArray[np.float64]]
    broadcasts: list[list[tuple[NDArray[np.intp], NDArray[Any]]]]
    memory: Memory
    models: NDArray[np.float64]

    def differs(self, other: "Trial") -> int | None:
        """First tick in which two trials differ; the number of ticks: only at the end; None: they are equal."""
        ticks = len(self.commands)
        for tick in range(ticks):
            if not same(self.commands[tick], other.commands[tick]) or len(self.broadcasts[tick]) != len(
                other.broadcasts[tick]
            ):
                return tick
            for (source, payload), (also, its) in zip(self.broadcasts[tick], other.broadcasts[tick], strict=True):
                if not same(source, also) or not same(payload, its):
                    return tick
        return ticks if alike(self.memory, other.memory) or not same(self.models, other.models) else None


class PointSwarm:
    """Small swarm of points that a class of controllers flies; its errors raise ConformanceError.

    Attributes:
        controller: the class of a controller or filter. make: makes an instance. declared: its declarations.
        uavs: numbers of the UAVs, (N,). plan: initial states, (N, 2d), m and m/s.
    """

    def __init__(self, controller: Any, scenario: Scenario, make: Callable[[], Controller]) -> None:
        self.controller = controller
        self._scenario = scenario
        self._check_models = partial(guard.check_bounded, most=bound_of_models(scenario))
        self.make = make
        self.plan = starts(scenario)
        self.uavs = np.arange(scenario.uavs)
        instance = self.make()
        try:
            # Checks of a flight, of this instance.
            self.declared = declarations_of(instance, controller.name)
            with suppress(ModuleNotFoundError):  # where only agents are, there are no files with columns
                from meanflock.results.quantities import check_columns

                check_columns(f"controller {controller.name!r}: `diagnostics`", self.declared.diagnostics)
        except BadInput as error:
            fail(controller, str(error), "fix the declaration")
        period = scenario.federation.period or self.declared.period_ticks
        self._period = period if self.declared.is_federated else 0
        self._ticks = max(TICKS, ROUNDS * self._period + AFTER)
        self.long = max(LONG, self._ticks)
        draw = np.random.default_rng(0)
        self._axes = scenario.dimensions
        self._shake = draw.standard_normal((self.long, scenario.uavs, self._axes))
        self._arrives = draw.random((self.long, scenario.uavs, scenario.uavs)) > LOST

    def init(self, instance: Controller, uavs: NDArray[np.intp]) -> Memory:
        """Initial memory of UAVs with numbers (M,)."""
        given = uavs.copy(), self.plan.copy()
        try:
            memory = instance.init(*given)
            guard.check_memory("memory", memory, len(uavs))
        except FAILURES as error:
            fail(
                self.controller,
                f"`init` with {len(uavs)} UAVs failed: {last_line(error)}",
                "return a dict of arrays, a row a UAV",
            )
        if not same(given[0], uavs) or not same(given[1], self.plan):
            fail(self.controller, "`init` writes to an array it was given", PURE)
        check_kept(self.controller, "memory", memory)
        return memory

    def step(
        self,
        instance: Controller,
        memory: Memory,
        tick: int,
        own: States,
        received: Sequence[Received],
        remedy: str = "fix it",
    ) -> Step:
        """One step of UAVs with states `own`, (M, 4)."""
        try:
            return instance.step(memory, tick, own, received)
        except FAILURES as error:
            fail(self.controller, f"`step` with {len(own)} UAVs failed in tick {tick}: {last_line(error)}", remedy)

    def set(
        self,
        instance: Controller,
        memory: Memory,
        rows: NDArray[np.intp],
        models: NDArray[np.float64],
        remedy: str = SET,
    ) -> Memory:
        """The memory after models (R, parameters) were set in some rows (R,)."""
        before = copies((rows, models))
        arrival = Arrival(1, models, np.ones(len(rows), dtype=bool), [b""] * len(rows))
        after = asked(self.controller, instance.arrived, memory, rows, arrival, remedy=remedy)
        if not all(same(one, other) for one, other in zip(before, (rows, models), strict=True)):
            fail(self.controller, "`set` writes to an array it was given", PURE)
        try:
            guard.check_same_form("memory", after, memory)
        except (TypeError, ValueError) as error:
            fail(self.controller, f"`set` returns what a flight cannot use: {error}", SET)
        return after

    def models(
        self, instances: Sequence[Controller], memories: Sequence[Memory], remedy: str = GET
    ) -> NDArray[np.float64]:
        """The models of the UAVs of several instances, in the order of these, (M, parameters)."""
        width, models = self.declared.parameters, []
        for instance, memory in zip(instances, memories, strict=True):
            table = asked(self.controller, instance.get, memory, remedy=remedy)
            expected = (len(next(iter(memory.values()))), width)
            if np.shape(table) != expected:
                fail(self.controller, f"`get` returns shape {np.shape(table)}, expected {expected}", GET)
            self.check("get", table, self._check_models)
            models.append(table)
        return np.concatenate(models)

    def check(self, called: str, table: Any, check: Callable[[str, NDArray[Any]], None]) -> None:
        """Check the numbers that a method returned."""
        try:
            check(f"result of `{called}`", np.asarray(table))
        except ValueError as error:
            fail(self.controller, str(error), FINITE)

    def checked(self, step: Step, before: Memory, rows: int) -> NDArray[np.float64]:
        """Check a step after the memory `before`; returns its commands (M, 2 + K)."""
        try:
            blank = np.zeros((rows, self._axes + len(self.declared.diagnostics)))
            commands, _ = checked_step(step, before, blank, self.declared, len(self.uavs))
        except FAILURES as error:
            fail(
                self.controller,
                f"`step` returned what a flight cannot use: {last_line(error)}",
                "return what is declared",
            )
        check_kept(self.controller, "memory", step.memory)
        for number, broadcast in enumerate(step.broadcasts):
            if not np.isfinite(self._on_air(broadcast.payload)).all():
                problem = f"broadcast {number} has a number that is not finite, or is so as a float of the radio"
                remedy = "such a frame is not sent; guard divisions, roots and empty sums"
                fail(self.controller, problem, remedy)
        try:
            guard.check_bounded("`step`: a command or diagnostic", commands)
        except ValueError as error:
            fail(self.controller, str(error), FINITE)
        return commands

    def trial(
        self, alone: bool = False, afresh: bool = False, seed: int = 1, number: int = 1, ticks: int | None = None
    ) -> Trial:
        """Fly all UAVs.

        Args:
            alone: an instance for each UAV, else one for all. afresh: a new instance in every tick, which gets only the
                memory, encoded and decoded. seed: of the global generators of Python and NumPy. number: of threads of
                the numeric libraries. ticks: None: two rounds, and 40 ticks at least.
        """
        groups = [np.array([uav]) for uav in self.uavs] if alone else [self.uavs]
        return with_surroundings(
            self.controller, RANDOM, lambda: self._fly(groups, afresh, ticks or self._ticks), seed, number
        )

    def side_by_side(self) -> list[Trial]:
        """Fly all UAVs twice, at once in two threads."""

        def both() -> list[Trial]:
            return each(lambda _: self._fly([self.uavs], False, self._ticks), range(2))

        return with_surroundings(self.controller, RANDOM, both, seed=1)

    def received(self, step: Step, uavs: NDArray[np.intp], arrives: NDArray[np.bool_]) -> list[Received]:
        """Broadcasts of UAVs (M,) as all others receive them; arrives: (N, N), from source to target."""
        sent = [
            self._frames(number, uavs if one.rows is None else uavs[one.rows], np.array(one.payload), arrives)
            for number, one in enumerate(step.broadcasts)
        ]
        return [frames for frames in sent if frames is not None]

    def _fly(self, groups: Sequence[NDArray[np.intp]], afresh: bool, ticks: int) -> Trial:
        """Fly with one instance for all UAVs, or with one for each. In the tick after a round the mean of all models
        arrives at the UAVs that the radio of the first one reaches.
        """
        instances = [self.make() for _ in groups]
        memories = [self.init(one, group) for one, group in zip(instances, groups, strict=True)]
        own, columns = self.plan.copy(), self._axes + len(self.declared.diagnostics)
        remedies = {"remedy": GONE} if afresh else {}
        frames: list[Received] = []
        commands, broadcasts = [], []
        mean: NDArray[np.float64] | None = None
        for tick in range(ticks):
            sent: dict[int, list[tuple[NDArray[np.intp], NDArray[Any]]]] = {}
            now = np.zeros((len(own), columns))
            for k, group in enumerate(groups):
                if afresh:
                    instances[k], memories[k] = self.make(), _read_back(memories[k])
                reached = np.flatnonzero(self._arrives[tick, 0, group])
                if mean is not None and len(reached):
                    models = np.repeat(mean[None], len(reached), axis=0)
                    memories[k] = self.set(instances[k], memories[k], reached, models, **remedies)
                received = tuple(frames) if len(groups) == 1 else received_by(frames, k)
                step = self.step(instances[k], memories[k], tick, own[group], received, **remedies)
                now[group] = self.checked(step, memories[k], len(group))
                memories[k] = step.memory
                for number, broadcast in enumerate(step.broadcasts):
                    rows = group if broadcast.rows is None else group[broadcast.rows]
                    sent.setdefault(number, []).append((rows, np.array(broadcast.payload)))
            joined = [self._joined(number, sent[number]) for number in sorted(sent)]
            frames = [
                batch
                for number, (source, payload) in enumerate(joined)
                if (batch := self._frames(number, source, payload, self._arrives[tick])) is not None
            ]
            mean = None
            if self._period and tick and tick % self._period == 0:
                mean = self._on_air(self.models(instances, memories, **remedies)).astype(np.float64).mean(axis=0)
            commands.append(now)
            broadcasts.append(joined)
            own = self._moved(own, now[:, : self._axes], tick)
        memory = {name: np.concatenate([one[name] for one in memories]) for name in memories[0]}
        models = self.models(instances, memories) if self.declared.parameters else np.zeros((len(own), 0))
        return Trial(commands, broadcasts, memory, models)

    def _joined(
        self, number: int, sent: list[tuple[NDArray[np.intp], NDArray[Any]]]
    ) -> tuple[NDArray[np.intp], NDArray[Any]]:
        """Join a broadcast of all groups, sources ascending."""
        if len({(payload.shape[1], payload.dtype.str) for _, payload in sent}) > 1:
            problem = f"broadcast {number} is {' and '.join(sorted({f'{p.shape[1]} × {p.dtype}' for _, p in sent}))}"
            fail(self.controller, f"{problem}, depending on the UAV", "broadcast equally many numbers of one type")
        source, payload = np.concatenate([rows for rows, _ in sent]), np.concatenate([payload for _, payload in sent])
        order = np.argsort(source, kind="stable")
        return source[order], payload[order]

    def _moved(self, own: States, acceleration: NDArray[np.float64], tick: int) -> States:
        dt = self._scenario.dt
        velocity = state.velocity(own) + dt * np.clip(acceleration, -50.0, 50.0) + 0.03 * self._shake[tick]
        return np.concatenate([state.position(own) + dt * velocity, velocity], axis=-1)

    def _on_air(self, payload: NDArray[Any]) -> NDArray[Any]:
        """A broadcast, its floats as floats of the radio."""
        if payload.dtype.kind != "f":
            return payload
        with np.errstate(over="ignore"):
            return payload.astype(FLOAT_OF_BITS[self._scenario.radio.bits_per_float])

    def _frames(
        self, number: int, source: NDArray[np.intp], payload: NDArray[Any], arrives: NDArray[np.bool_]
    ) -> Received | None:
        """A broadcast as received by all but its sender, without lost frames."""
        if payload.dtype.kind == "f":
            payload = self._on_air(payload).astype(np.float64)
        reaches = arrives[source] & (source[:, None] != self.uavs)
        links = np.stack(np.nonzero(reaches), axis=-1)
        return Received(number, source, payload, links) if len(links) else None


def _read_back(memory: Memory) -> Memory:
    stored = decode_record(encode_record({name: np.ascontiguousarray(array) for name, array in memory.items()}))
    return {name: np.array(array) for name, array in stored.items()}
