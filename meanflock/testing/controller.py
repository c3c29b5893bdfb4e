"""The conformance suite of controllers."""

import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.agent.controllers.base import Controller, Memory, Received, Step
from meanflock.agent.rows import checked_memory, checked_step, of_row
from meanflock.swarm import declared as declarations
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import AXES, States
from meanflock.swarm.wire.control import decode_record, encode_record
from meanflock.testing.error import alike, copies, fail, make, same, with_other_randomness
from meanflock.worldsim.formation import initial_states

UAVS, TICKS = 6, 40
LOST = 0.2  # share of the frames that the radio loses in the trial

_ROWS = "compute every row from that row of `own` and `memory`, and from the frames linked to it in `received`, alone"
_MEMORY = "keep all that one tick leaves to the next in the arrays of the memory you return"
_RANDOM = 'draw from mf.seeds.generator(seed, "controller", index), the index made of the tick and the UAV\'s number'
_PURE = "return new arrays; copy before you write"


class Trial(NamedTuple):
    """What a controller did in every tick of a trial: commands (M, 2 + K), broadcasts, and its last memory."""

    commands: list[NDArray[np.float64]]
    spoken: list[list[tuple[NDArray[np.intp], NDArray[Any]]]]
    memory: Memory
    models: NDArray[np.float64]


def check_controller(
    controller: type[Controller],
    options: dict[str, Any] | None = None,
    scenario: Scenario | None = None,
    slow_ms: float = 50.0,
) -> None:
    """Flies a small swarm of points with a controller and checks everything that a flight relies on.

    Args:
        controller: the class. options: as in the table [controller]. scenario: another one than the paper's with six
        UAVs. slow_ms: what a tick of all UAVs may take, median.

    Raises:
        ConformanceError: a check fails; the text says what to mend.
    """
    flown = scenario or Scenario(uavs=UAVS)
    flown = msgspec.structs.replace(flown, method=controller.name, controller=dict(options or {}))
    suite = _Suite(controller, flown, options or {})
    suite.declarations()
    suite.empty_rows()
    suite.silence()
    together = suite.trial()
    suite.pure()
    suite.deterministic(together)
    suite.rows_alone(together)
    suite.checkpointed(together)
    suite.models(together)
    suite.quick(slow_ms)


class _Suite:
    def __init__(self, controller: type[Controller], scenario: Scenario, options: dict[str, Any]) -> None:
        self._class, self._scenario, self._options = controller, scenario, options
        self._plan = initial_states(scenario)
        self._uavs = np.arange(scenario.uavs)
        draw = np.random.default_rng(0)
        self._shake = draw.standard_normal((TICKS, scenario.uavs, AXES))
        self._arrives = draw.random((TICKS, scenario.uavs, scenario.uavs)) > LOST

    def declarations(self) -> None:
        made = self._make()
        try:
            # What a flight asks of the class, of this very instance.
            self._declared = declarations.of(made, self._class.name)
        except BadInput as error:
            fail(self._class, str(error), "mend the declaration")

    def empty_rows(self) -> None:
        """A node without rows is of use to nobody, but arrays of none must come out as such."""
        made, none = self._make(), np.zeros((0, 4))
        memory = self._init(made, self._uavs[:0])
        self._checked(self._stepped(made, memory, 0, none, ()), memory, 0)

    def silence(self) -> None:
        """A flight in which nothing is ever received."""
        made = self._make()
        memory = self._init(made, self._uavs)
        for tick in range(3):
            step = self._stepped(made, memory, tick, self._plan, ())
            self._checked(step, memory, len(self._uavs))
            memory = step.memory

    def trial(self, rows: Sequence[int] | None = None, seed: int = 1) -> Trial:
        """A swarm of points under the commands of one instance for all, or of one for `rows` and another for the
        rest.
        """
        groups = [self._uavs] if rows is None else [np.array([row]) for row in rows]
        return with_other_randomness(lambda: self._fly(groups), seed)

    def pure(self) -> None:
        """No argument is written to."""
        made = self._make()
        memory = self._init(made, self._uavs)
        own = self._plan + 0.5
        first = self._stepped(made, memory, 1, own, ())
        received = self._received(first, self._uavs, np.ones((len(own), len(own)), bool))
        memory = first.memory
        given = [own, *memory.values(), *(array for frames in received for array in (frames.payload, frames.links))]
        before = copies(given)
        self._stepped(made, memory, 2, own, received)
        if not all(same(one, other) for one, other in zip(before, given, strict=True)):
            fail(self._class, "`step` writes to an array it was given", _PURE)

    def deterministic(self, together: Trial) -> None:
        """The same flight twice, whatever the global generators of Python and NumPy say."""
        if (difference := _difference(together, self.trial(seed=2))) is not None:
            fail(self._class, f"the same flight came out otherwise a second time, in tick {difference}", _RANDOM)

    def rows_alone(self, together: Trial) -> None:
        """Every row flown by an instance of its own."""
        if (difference := _difference(together, self.trial(rows=list(self._uavs)))) is not None:
            fail(
                self._class,
                f"a UAV flies otherwise beside others in one process than alone, from tick {difference} on",
                _ROWS,
            )

    def checkpointed(self, together: Trial) -> None:
        """In every tick another instance, which knows nothing but the memory, written and read back."""
        afresh = self._fly([self._uavs], afresh=True)
        if (difference := _difference(together, afresh)) is not None:
            fail(self._class, f"a flight that goes on from a checkpoint differs in tick {difference}", _MEMORY)

    def models(self, together: Trial) -> None:
        """What is uploaded can be set, and reaches the rows it is for."""
        made, parameters = self._make(), self._declared.parameters
        for method, width, name in (
            (made.get, parameters, "parameters"),
            (made.report, self._declared.weights, "weights"),
        ):
            shape = np.shape(method(together.memory)) if width else (len(self._uavs), 0)
            if shape != (len(self._uavs), width):
                mend = f"return one row a UAV, `{name}` wide"
                fail(
                    self._class, f"`{method.__name__}` returns shape {shape}, expected {(len(self._uavs), width)}", mend
                )
        if not parameters:
            return
        model = np.linspace(-1.0, 1.0, parameters)
        rows = np.array([0, len(self._uavs) - 1])
        before = {name: array.copy() for name, array in together.memory.items()}
        after = made.set(together.memory, rows, np.stack([model, model]))
        if (written := alike(before, together.memory)) is not None:
            fail(self._class, f"`set` writes to memory[{written!r}]", _PURE)
        got, had = made.get(after), made.get(together.memory)
        if not np.allclose(got[rows], model):
            fail(self._class, "`get` does not return what was `set`", "store the model in the memory")
        if not same(np.delete(got, rows, axis=0), np.delete(had, rows, axis=0)):
            fail(self._class, "`set` changes rows it was not told to", "write to `rows` only")

    def quick(self, slow_ms: float) -> None:
        made = self._make()
        memory = self._init(made, self._uavs)
        took = []
        for tick in range(1, 12):
            began = time.perf_counter()
            memory = self._stepped(made, memory, tick, self._plan, ()).memory
            took.append(1e3 * (time.perf_counter() - began))
        if (median := float(np.median(took))) > slow_ms:
            mend = f"make it quicker, or pass a larger `slow_ms` than {slow_ms:g}"
            fail(self._class, f"a tick of {len(self._uavs)} UAVs takes {median:.0f} ms", mend)

    # -- a trial ------------------------------------------------------------------------------------------------

    def _make(self) -> Controller:
        made: Controller = make(self._class, self._options, self._scenario)
        return made

    def _init(self, made: Controller, uavs: NDArray[np.intp]) -> Memory:
        try:
            return checked_memory(made.init(uavs, self._plan.copy()), len(uavs))
        except Exception as error:
            fail(
                self._class,
                f"`init` with {len(uavs)} UAVs failed: {_text(error)}",
                "return a dict of arrays, a row a UAV",
            )

    def _stepped(self, made: Controller, memory: Memory, tick: int, own: States, received: Sequence[Received]) -> Step:
        try:
            return made.step(memory, tick, own, received)
        except Exception as error:
            fail(self._class, f"`step` with {len(own)} UAVs failed in tick {tick}: {_text(error)}", "mend it")

    def _checked(self, step: Step, before: Memory, rows: int) -> NDArray[np.float64]:
        try:
            commands = checked_step(step, before, rows, self._declared)
        except Exception as error:
            fail(self._class, f"`step` returned what a flight cannot use: {_text(error)}", "return what is declared")
        if not np.isfinite(commands).all():
            fail(self._class, "`step` returned a number that is not finite", "guard divisions, roots and empty sums")
        return commands

    def _fly(self, groups: Sequence[NDArray[np.intp]], afresh: bool = False) -> Trial:
        """Points pushed by the commands of one instance a group; `afresh`: another instance in every tick."""
        made = [self._make() for _ in groups]
        memories = [self._init(one, group) for one, group in zip(made, groups, strict=True)]
        own, columns = self._plan.copy(), AXES + len(self._declared.diagnostics)
        frames: list[Received] = []
        commands, spoken = [], []
        for tick in range(TICKS):
            said: dict[int, list[tuple[NDArray[np.intp], NDArray[Any]]]] = {}
            now = np.zeros((len(own), columns))
            for k, group in enumerate(groups):
                if afresh:
                    made[k], memories[k] = self._make(), _read_back(memories[k])
                heard = _for(group, frames)
                step = self._stepped(made[k], memories[k], tick, own[group], heard)
                now[group] = self._checked(step, memories[k], len(group))
                memories[k] = step.memory
                for number, broadcast in enumerate(step.broadcasts):
                    rows = group if broadcast.rows is None else group[broadcast.rows]
                    said.setdefault(number, []).append((rows, np.array(broadcast.payload)))
            joined = [_joined(said[number]) for number in sorted(said)]
            frames = [
                received
                for number, (source, payload) in enumerate(joined)
                if (received := self._frames(number, source, payload, self._arrives[tick])) is not None
            ]
            commands.append(now)
            spoken.append(joined)
            own = self._moved(own, now[:, :AXES], tick)
        memory = {name: np.concatenate([one[name] for one in memories]) for name in memories[0]}
        models = np.zeros((len(own), 0))
        if self._declared.parameters:
            models = np.concatenate([one.get(kept) for one, kept in zip(made, memories, strict=True)])
        return Trial(commands, spoken, memory, models)

    def _moved(self, own: States, acceleration: NDArray[np.float64], tick: int) -> States:
        dt = self._scenario.dt
        velocity = own[:, 2:] + dt * np.clip(acceleration, -50.0, 50.0) + 0.03 * self._shake[tick]
        return np.concatenate([own[:, :2] + dt * velocity, velocity], axis=-1)

    def _received(self, step: Step, uavs: NDArray[np.intp], arrives: NDArray[np.bool_]) -> list[Received]:
        said = [
            self._frames(number, uavs if one.rows is None else uavs[one.rows], np.array(one.payload), arrives)
            for number, one in enumerate(step.broadcasts)
        ]
        return [frames for frames in said if frames is not None]

    def _frames(
        self, number: int, source: NDArray[np.intp], payload: NDArray[Any], arrives: NDArray[np.bool_]
    ) -> Received | None:
        """A broadcast as it reaches everyone but its sender, but for what is lost."""
        if payload.dtype.kind == "f":
            payload = payload.astype(np.float32).astype(np.float64)
        reaches = arrives[source] & (source[:, None] != self._uavs)
        links = np.stack(np.nonzero(reaches), axis=-1)
        return Received(number, source, payload, links) if len(links) else None


def _for(group: NDArray[np.intp], frames: Sequence[Received]) -> tuple[Received, ...]:
    """What the UAVs of a group receive, links renumbered to its rows."""
    own: list[Received] = []
    for batch in frames:
        mine = batch.links[np.isin(batch.links[:, 1], group)]
        if len(mine):
            links = np.stack([mine[:, 0], np.searchsorted(group, mine[:, 1])], axis=-1)
            one = Received(batch.number, batch.source, batch.payload, links)
            own += of_row((one,), 0) if len(group) == 1 else (one,)
    return tuple(own)


def _joined(said: list[tuple[NDArray[np.intp], NDArray[Any]]]) -> tuple[NDArray[np.intp], NDArray[Any]]:
    source, payload = np.concatenate([rows for rows, _ in said]), np.concatenate([payload for _, payload in said])
    order = np.argsort(source, kind="stable")
    return source[order], payload[order]


def _read_back(memory: Memory) -> Memory:
    kept = decode_record(encode_record({name: np.ascontiguousarray(array) for name, array in memory.items()}))
    return {name: np.array(array) for name, array in kept.items()}


def _difference(one: Trial, other: Trial) -> int | None:
    """The first tick in which two trials differ."""
    for tick in range(TICKS):
        if not same(one.commands[tick], other.commands[tick]) or len(one.spoken[tick]) != len(other.spoken[tick]):
            return tick
        for (source, payload), (also, its) in zip(one.spoken[tick], other.spoken[tick], strict=True):
            if not same(source, also) or not same(payload, its):
                return tick
    return TICKS if alike(one.memory, other.memory) or not same(one.models, other.models) else None


def _text(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"
