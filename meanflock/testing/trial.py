"""Trial flight of a controller: a swarm of points, and a radio that loses some of their frames."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meanflock.agent.controllers.base import Controller, Memory, Received, Step
from meanflock.agent.guarded import checked_step, received_by
from meanflock.swarm.declared import declarations_of
from meanflock.swarm.errors import FAILURES, BadInput, last_line
from meanflock.swarm.mission import starts
from meanflock.swarm.plugins import guard
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import AXES, States
from meanflock.swarm.wire.control import decode_record, encode_record
from meanflock.testing.error import alike, asked, check_kept, fail, same, with_other_randomness

TICKS = 40
LOST = 0.2  # share of the frames that the radio loses in the trial


class Trial(NamedTuple):
    """Record of a trial: commands (N, 2 + K) and broadcasts of every tick, memory and models at the end."""

    commands: list[NDArray[np.float64]]
    broadcasts: list[list[tuple[NDArray[np.intp], NDArray[Any]]]]
    memory: Memory
    models: NDArray[np.float64]

    def differs(self, other: "Trial") -> int | None:
        """First tick in which two trials differ; `TICKS`: they differ only at the end; None: they are equal."""
        for tick in range(TICKS):
            if not same(self.commands[tick], other.commands[tick]) or len(self.broadcasts[tick]) != len(
                other.broadcasts[tick]
            ):
                return tick
            for (source, payload), (also, its) in zip(self.broadcasts[tick], other.broadcasts[tick], strict=True):
                if not same(source, also) or not same(payload, its):
                    return tick
        return TICKS if alike(self.memory, other.memory) or not same(self.models, other.models) else None


class PointSwarm:
    """Small swarm of points that a class of controllers flies; its errors raise ConformanceError.

    Attributes:
        controller: the class of a controller or filter. make: makes an instance. declared: its declarations.
        uavs: numbers of the UAVs, (N,). plan: initial states, (N, 4), m and m/s.
    """

    def __init__(self, controller: Any, scenario: Scenario, make: Callable[[], Controller]) -> None:
        self.controller = controller
        self._scenario = scenario
        self.make = make
        self.plan = starts(scenario)
        self.uavs = np.arange(scenario.uavs)
        draw = np.random.default_rng(0)
        self._shake = draw.standard_normal((TICKS, scenario.uavs, AXES))
        self._arrives = draw.random((TICKS, scenario.uavs, scenario.uavs)) > LOST
        instance = self.make()
        try:
            # Checks of a flight, of this instance.
            self.declared = declarations_of(instance, controller.name)
            with suppress(ModuleNotFoundError):  # where only agents are, there are no files with columns
                from meanflock.groundstation.results.quantities import check_diagnostics

                check_diagnostics(controller.name, self.declared.diagnostics)
        except BadInput as error:
            fail(controller, str(error), "fix the declaration")

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
            fail(self.controller, "`init` writes to an array it was given", "return new arrays; copy before you write")
        check_kept(self.controller, "memory", memory)
        return memory

    def step(self, instance: Controller, memory: Memory, tick: int, own: States, received: Sequence[Received]) -> Step:
        """One step of UAVs with states `own`, (M, 4)."""
        try:
            return instance.step(memory, tick, own, received)
        except FAILURES as error:
            fail(self.controller, f"`step` with {len(own)} UAVs failed in tick {tick}: {last_line(error)}", "fix it")

    def checked(self, step: Step, before: Memory, rows: int) -> NDArray[np.float64]:
        """Check a step after the memory `before`; returns its commands (M, 2 + K)."""
        try:
            blank = np.zeros((rows, AXES + len(self.declared.diagnostics)))
            commands, _ = checked_step(step, before, blank, self.declared, len(self.uavs))
        except FAILURES as error:
            fail(
                self.controller,
                f"`step` returned what a flight cannot use: {last_line(error)}",
                "return what is declared",
            )
        check_kept(self.controller, "memory", step.memory)
        for number, broadcast in enumerate(step.broadcasts):
            if not np.isfinite(broadcast.payload).all():
                remedy = "such a frame is not sent; guard divisions, roots and empty sums"
                fail(self.controller, f"broadcast {number} has a number that is not finite", remedy)
        if not np.isfinite(commands).all():
            fail(
                self.controller, "`step` returned a number that is not finite", "guard divisions, roots and empty sums"
            )
        return commands

    def trial(self, alone: bool = False, afresh: bool = False, seed: int = 1) -> Trial:
        """Fly all UAVs.

        Args:
            alone: an instance for each UAV, else one for all. afresh: a new instance in every tick, which gets only the
                memory, encoded and decoded. seed: of the global generators of Python and NumPy.
        """
        groups = [np.array([uav]) for uav in self.uavs] if alone else [self.uavs]
        return with_other_randomness(lambda: self._fly(groups, afresh), seed)

    def received(self, step: Step, uavs: NDArray[np.intp], arrives: NDArray[np.bool_]) -> list[Received]:
        """Broadcasts of UAVs (M,) as all others receive them; arrives: (N, N), from source to target."""
        sent = [
            self._frames(number, uavs if one.rows is None else uavs[one.rows], np.array(one.payload), arrives)
            for number, one in enumerate(step.broadcasts)
        ]
        return [frames for frames in sent if frames is not None]

    def _fly(self, groups: Sequence[NDArray[np.intp]], afresh: bool) -> Trial:
        """Fly with one instance for each group of UAVs."""
        instances = [self.make() for _ in groups]
        memories = [self.init(one, group) for one, group in zip(instances, groups, strict=True)]
        own, columns = self.plan.copy(), AXES + len(self.declared.diagnostics)
        frames: list[Received] = []
        commands, broadcasts = [], []
        for tick in range(TICKS):
            sent: dict[int, list[tuple[NDArray[np.intp], NDArray[Any]]]] = {}
            now = np.zeros((len(own), columns))
            for k, group in enumerate(groups):
                if afresh:
                    instances[k], memories[k] = self.make(), _read_back(memories[k])
                step = self.step(instances[k], memories[k], tick, own[group], _for(group, frames))
                now[group] = self.checked(step, memories[k], len(group))
                memories[k] = step.memory
                for number, broadcast in enumerate(step.broadcasts):
                    rows = group if broadcast.rows is None else group[broadcast.rows]
                    sent.setdefault(number, []).append((rows, np.array(broadcast.payload)))
            joined = [self._joined(number, sent[number]) for number in sorted(sent)]
            frames = [
                received
                for number, (source, payload) in enumerate(joined)
                if (received := self._frames(number, source, payload, self._arrives[tick])) is not None
            ]
            commands.append(now)
            broadcasts.append(joined)
            own = self._moved(own, now[:, :AXES], tick)
        memory = {name: np.concatenate([one[name] for one in memories]) for name in memories[0]}
        models = np.zeros((len(own), 0))
        if self.declared.parameters:
            remedy = "return one row a UAV, `parameters` wide"
            found = [
                asked(self.controller, one.get, stored, remedy=remedy)
                for one, stored in zip(instances, memories, strict=True)
            ]
            models = np.concatenate(found)
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
        velocity = own[:, 2:] + dt * np.clip(acceleration, -50.0, 50.0) + 0.03 * self._shake[tick]
        return np.concatenate([own[:, :2] + dt * velocity, velocity], axis=-1)

    def _frames(
        self, number: int, source: NDArray[np.intp], payload: NDArray[Any], arrives: NDArray[np.bool_]
    ) -> Received | None:
        """A broadcast as received by all but its sender, without lost frames."""
        if payload.dtype.kind == "f":
            payload = payload.astype(np.float32).astype(np.float64)
        reaches = arrives[source] & (source[:, None] != self.uavs)
        links = np.stack(np.nonzero(reaches), axis=-1)
        return Received(number, source, payload, links) if len(links) else None


def _for(group: NDArray[np.intp], frames: Sequence[Received]) -> tuple[Received, ...]:
    """Frames that the UAVs of a group receive, with links to its rows."""
    own: list[Received] = []
    for batch in frames:
        mine = batch.links[np.isin(batch.links[:, 1], group)]
        if len(mine):
            links = np.stack([mine[:, 0], np.searchsorted(group, mine[:, 1])], axis=-1)
            one = Received(batch.number, batch.source, batch.payload, links)
            own += received_by((one,), 0) if len(group) == 1 else (one,)
    return tuple(own)


def _read_back(memory: Memory) -> Memory:
    stored = decode_record(encode_record({name: np.ascontiguousarray(array) for name, array in memory.items()}))
    return {name: np.array(array) for name, array in stored.items()}
