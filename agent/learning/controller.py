"""Controller that flies by another one, and trains by a learner.

A row trains on the newest global model as soon as it is free. Its training takes simulated time:

    fit_s + example_s · examples, times the slowness of the UAV.

This time is rounded up to ticks, one at least. The trained model exists from the tick on in which it is over, and waits
for the next round in which its UAV takes part. A row without a trained model is silent in a round. Its next training
may begin meanwhile, from a newer global model; its result takes the place of a model that waits.

A row that has nothing to do when a round opens has heard of no newer global model since its model was sent: the radio
lost it, or all uploads. It goes on from its own model, or if it has none from the newest global model, so one round in
which everything is lost does not end the learning.

All that a training depends on is in the memory, so it can be repeated: after a checkpoint, or if a row is stepped
again. The thread that trains, and the results that it has, are a cache of that. Arrays of the memory have names that
begin with `learner_`.
"""

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.agent.controllers.base import Arrival, Controller, Memory, Prediction, Received, Rows, Step
from meanflock.agent.learning.base import Fit, Learner, Trained, TrainingFailed, Tree
from meanflock.agent.learning.surroundings import check_isa, seeded
from meanflock.agent.learning.trees import ModelForm
from meanflock.agent.learning.worker import TRAININGS, Job, Owner, started_threads
from meanflock.federation.codec import check_weights
from meanflock.federation.cut import bound_of_models
from meanflock.federation.schedule import drawn
from meanflock.swarm import seeds
from meanflock.swarm.counts import count_of
from meanflock.swarm.declared import MAX_NOTE_BYTES, MAX_PARAMETERS, column_names
from meanflock.swarm.errors import FAILURES, BadInput, last_line
from meanflock.swarm.events.nodes import FailedTraining, Problem
from meanflock.swarm.global_generators import global_state
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats, Mask, States, contains

PREFIX = "learner_"
_ALWAYS = "examples", "training"  # diagnostics after those that the learner declares
RECORDED = 10_000  # floats; larger models are not recorded
_SIZE = 4  # bytes of a length
_INITIAL = 0  # index of the seed of the first model; those of trainings follow


class TrainingResult(NamedTuple):
    """Checked result of a training. problem: why there is no model to upload; empty if there is one.

    threads: number of threads that it left running.
    """

    model: Floats
    kept: NDArray[np.uint8]
    examples: float
    metrics: dict[str, float]
    note: bytes
    state: bytes
    problem: str
    threads: int


class Learning:
    """Controller `inner` with the rounds of a learner; see `Controller` for its methods."""

    def __init__(self, options: Any, scenario: Scenario, inner: Controller, learner: type[Learner]) -> None:
        """Raises BadInput if the first model cannot be shared."""
        self.options, self.scenario, self.inner, self.learner = options, scenario, inner, learner
        table = self._table = scenario.training
        check_isa(table.torch_isa)
        self._name = f"learner {learner.name!r}"
        if isinstance(learner.keeps, str):
            raise BadInput(f"{self._name}: `keeps` is a text; write ({learner.keeps!r},)")
        try:
            first = TRAININGS.call(self._initial, self._new_owner())
            self._form = ModelForm(first, table.integers, (*learner.keeps, *table.keeps))
            self._first = self._form.split(first)
        except FAILURES as error:
            raise BadInput(f"{self._name}: `initial`: {last_line(error)}") from error
        self._limit = bound_of_models(scenario)
        if not np.abs(self._first[0]).max() < self._limit:
            raise BadInput(f"{self._name}: `initial` has a number that is not finite, or {self._limit:g} or more")
        if self._form.parameters > MAX_PARAMETERS:
            raise BadInput(
                f"{self._name}: its model has {self._form.parameters} numbers, and at most {MAX_PARAMETERS} are sent; "
                "let some stay with the UAV: training.keeps"
            )
        self.parameters, self.parts = self._form.parameters, self._form.parts
        self.weights = None if self.parameters <= RECORDED else 0
        self._metrics = column_names(f"{self._name}: `metrics`", self._declared("metrics"), _ALWAYS)
        self._state_bytes = self._count("state_bytes", 0)
        self.note_bytes = self._count("note_bytes", 0, MAX_NOTE_BYTES)
        self.period_ticks = self._count("period_ticks", 1)
        self.weighted = self.dated = True
        own = (*self._metrics, *_ALWAYS)
        inner_names = tuple(inner.diagnostics)
        own = tuple(PREFIX + name if name in inner_names else name for name in own)
        self.diagnostics = (*inner_names, *own)
        self.measured, self.busy = own[:-1], own[-1]
        self.broadcast_numbers, self.pairwise, self.shares = inner.broadcast_numbers, inner.pairwise, inner.shares
        self.recorded, self.guided = dict(inner.recorded), inner.guided
        self._learners: dict[int, Learner] = {}
        self._owners: dict[int, Owner] = {}
        self._jobs: dict[int, tuple[int, Job]] = {}  # of each UAV: the tick in which its training began, and the call

    def __reduce__(self) -> Any:
        """A copy begins without learners and results: it finds all it needs in the memory."""
        return Learning, (self.options, self.scenario, self.inner, self.learner)

    def init(self, uavs: NDArray[np.intp], plan: States) -> Memory:
        """See `Controller.init`."""
        before = global_state() if TRAININGS.is_idle else None
        inner_memory = self.inner.init(uavs, plan)
        with suppress(*FAILURES):  # the flight reports it
            self.inner.step(dict(inner_memory), 0, plan[uavs], ())
        self._check_draws(before)
        if taken := sorted(name for name in inner_memory if name.startswith(PREFIX)):
            raise ValueError(f"memory[{taken[0]!r}]: names that begin with {PREFIX!r} are those of the learner")
        try:
            TRAININGS.call(lambda: [self._learner(uav) for uav in uavs.tolist()], self._new_owner())
        except FAILURES as error:
            raise RuntimeError(f"{self._name}: {last_line(error)}") from error
        rows, (vector, kept) = len(uavs), self._first
        models = np.tile(vector, (rows, 1))
        own = {
            "uav": uavs.astype(np.int64),
            "slowness": np.array([self._slowness(uav) for uav in uavs.tolist()]),
            # The newest global model; `fresh`: no training has begun from it.
            "global": models,
            "fresh": np.ones(rows, dtype=bool),
            "round": np.zeros(rows, dtype=np.int64),
            "whole": np.ones(rows, dtype=bool),
            "heard": _packed([b""] * rows, self.note_bytes),
            # The training that goes on, if one does: from which model, in which tick and place; `ends` is 0 until it is
            # known. All zero, as in a lost UAV, is no training.
            "trains": np.zeros(rows, dtype=bool),
            "base": models.copy(),
            "base_round": np.zeros(rows, dtype=np.int64),
            "base_whole": np.ones(rows, dtype=bool),
            "base_heard": _packed([b""] * rows, self.note_bytes),
            "began": np.zeros(rows, dtype=np.int64),
            "ends": np.zeros(rows, dtype=np.int64),
            "place": np.zeros((rows, 2)),
            # The trained model, and all that is left of trainings.
            "model": models.copy(),
            "ready": np.zeros(rows, dtype=bool),
            "based": np.zeros(rows, dtype=np.int64),
            "measured": np.zeros(rows, dtype=bool),  # whether the last training gave all metrics
            "examples": np.ones(rows),
            "note": _packed([b""] * rows, self.note_bytes),
            "kept": np.tile(kept, (rows, 1)),
            "state": _packed([b""] * rows, self._state_bytes),
            "metrics": np.zeros((rows, len(self._metrics))),
        }
        return inner_memory | {PREFIX + name: array for name, array in own.items()}

    def step(self, memory: Memory, tick: int, own: States, received: Sequence[Received]) -> Step:
        """See `Controller.step`."""
        inner_memory, mine = _split(memory)
        flown = self._flown(inner_memory, tick, own, received)
        news: list[Problem] = []
        if self._is_event(mine, tick):
            mine = {name: array.copy() for name, array in mine.items()}
            number, since = divmod(tick, self.scenario.period_ticks)
            if since == 0:
                self._go_on(mine)
                participants = drawn(self.scenario, number)  # a round has just taken their models
                mine["ready"] &= ~contains(participants, mine["uav"])
            self._finish(mine, tick, news)
            self._begin(mine, tick, own)
        examples = np.where(mine["measured"], mine["examples"], 0.0)
        columns = [mine["metrics"], examples[:, None], mine["trains"][:, None]]
        reported = [] if flown.diagnostics is None else [flown.diagnostics]
        return msgspec.structs.replace(
            flown,
            memory=flown.memory | {PREFIX + name: array for name, array in mine.items()},
            diagnostics=np.concatenate([*reported, *columns], axis=1),
            news=(*flown.news, *news),
        )

    def guide(self, memory: Memory, rows: Rows, goals: Floats) -> Memory:
        """See `Controller.guide`."""
        return memory | self.inner.guide(_split(memory)[0], rows, goals)

    def get(self, memory: Memory) -> Floats:
        """The trained models; where there is none, the newest global model."""
        ready = memory[PREFIX + "ready"][:, None]
        return np.where(ready, memory[PREFIX + "model"], memory[PREFIX + "global"]).astype(np.float64)

    def set(self, memory: Memory, rows: Rows, models: Floats) -> Memory:
        """See `Controller.set`."""
        return self.arrived(memory, rows, Arrival(0, models, np.ones(len(rows), dtype=bool), [b""] * len(rows)))

    def arrived(self, memory: Memory, rows: Rows, arrival: Arrival) -> Memory:
        """See `Controller.arrived`."""
        changes = {"global": arrival.models, "fresh": True, "round": arrival.number, "whole": arrival.whole}
        changes["heard"] = _packed(arrival.notes, self.note_bytes)
        after = dict(memory)
        for name, values in changes.items():
            array = after[PREFIX + name] = memory[PREFIX + name].copy()
            array[rows] = values
        return after

    def ready(self, memory: Memory) -> Mask:
        """See `Controller.ready`."""
        return memory[PREFIX + "ready"]

    def based(self, memory: Memory) -> NDArray[np.integer]:
        """See `Controller.based`."""
        return memory[PREFIX + "based"]

    def note(self, memory: Memory) -> Sequence[bytes]:
        """See `Controller.note`."""
        return [_unpacked(row) for row in memory[PREFIX + "note"]]

    def samples(self, memory: Memory) -> Floats:
        """See `Controller.samples`."""
        return memory[PREFIX + "examples"]

    def report(self, memory: Memory) -> Floats:
        """See `Controller.report`."""
        return self.get(memory) if self.weights is None else np.zeros((len(memory[PREFIX + "uav"]), 0))

    def prediction(self) -> Prediction | None:
        """See `Controller.prediction`."""
        return self.inner.prediction()

    # -- trainings ----------------------------------------------------------------------------------------------

    def _flown(self, memory: Memory, tick: int, own: States, received: Sequence[Received]) -> Step:
        """The step of the controller. While nothing trains, it is checked that it draws from no global generator."""
        before = global_state() if TRAININGS.is_idle else None
        step = self.inner.step(memory, tick, own, received)
        self._check_draws(before)
        return step

    def _check_draws(self, before: tuple[Any, ...] | None) -> None:
        if before is not None and global_state() != before:
            raise RuntimeError(
                f"controller {self.scenario.method!r} draws from a global random generator, which trainings seed; draw "
                "from mf.seeds.generator instead"
            )

    def _is_event(self, mine: Memory, tick: int) -> bool:
        """Returns whether something of the memory of a learner changes in a tick."""
        opens = tick % self.scenario.period_ticks == 0 and (mine["ready"] | self._idle(mine)).any()
        return bool(opens or self._due(mine, tick).any() or (mine["fresh"] & ~mine["trains"]).any())

    def _idle(self, mine: Memory) -> Mask:
        """Rows that train again without a newer global model when a round opens; a lost UAV has no slowness."""
        busy = mine["fresh"] | mine["trains"] | mine["ready"]
        return ~busy & (mine["slowness"] > 0.0) & self.learner.trains_again

    def _go_on(self, mine: Memory) -> None:
        """Have rows that are idle train again, from their own model if it comes from the newest global model."""
        idle = self._idle(mine)
        own = idle & (mine["based"] == mine["round"])
        mine["global"][own] = mine["model"][own]
        mine["fresh"] |= idle

    def _begin(self, mine: Memory, tick: int, own: States) -> None:
        """Begin the trainings of rows that are free and have a new global model."""
        for row in np.flatnonzero(mine["fresh"] & ~mine["trains"]).tolist():
            mine["fresh"][row], mine["trains"][row] = False, True
            mine["began"][row], mine["ends"][row], mine["place"][row] = tick, 0, own[row, :2]
            for name in ("round", "whole", "heard"):
                mine[f"base_{name}"][row] = mine[name][row]
            mine["base"][row] = mine["global"][row]
            uav = int(mine["uav"][row])
            if self.learner.takes_part(self.options, self.scenario, uav, self._config(mine, row)):
                self._job(mine, row)
            else:
                mine["trains"][row] = False

    def _finish(self, mine: Memory, tick: int, news: list[Problem]) -> None:
        """Wait for trainings that may be over, and take the models of those that are."""
        for row in np.flatnonzero(self._due(mine, tick)).tolist():
            uav = int(mine["uav"][row])
            try:
                outcome: TrainingResult | None = TRAININGS.wait(self._job(mine, row))
            except FAILURES as error:
                raise RuntimeError(f"{self._name}: {last_line(error)}") from error
            if outcome is None:  # no part in this round
                mine["trains"][row] = False
                continue
            if not mine["ends"][row]:
                ticks = self._ticks(mine["slowness"][row], outcome.examples)
                mine["ends"][row] = mine["began"][row] + int(ticks)
                if outcome.threads:
                    threads = f"{outcome.threads} thread{'s' * (outcome.threads > 1)}"
                    news.append(f"{self._name} of UAV {uav} left {threads} running; end them in `fit`")
            if mine["ends"][row] <= tick:
                self._take(mine, row, outcome, news)

    def _take(self, mine: Memory, row: int, outcome: TrainingResult, news: list[Problem]) -> None:
        """End the training of a row with its outcome."""
        mine["trains"][row] = False
        if outcome.problem:
            uav = int(mine["uav"][row])
            news.append(FailedTraining(uav, f"{self._name} of UAV {uav}: {outcome.problem}; it uploads no model"))
            return
        mine["model"][row], mine["kept"][row], mine["ready"][row] = outcome.model, outcome.kept, True
        mine["based"][row], mine["examples"][row] = mine["base_round"][row], outcome.examples
        mine["note"][row] = _packed([outcome.note], self.note_bytes)[0]
        mine["state"][row] = _packed([outcome.state], self._state_bytes)[0]
        metrics = np.array([outcome.metrics.get(name, math.nan) for name in self._metrics])
        mine["measured"][row] = is_measured = bool(np.isfinite(metrics).all())
        if is_measured:
            mine["metrics"][row] = metrics

    def _ticks(self, slowness: Any, examples: float = 0.0) -> NDArray[np.int64]:
        """Ticks that a training takes."""
        seconds = (self._table.fit_s + self._table.example_s * examples) * slowness
        return np.ceil(np.clip(seconds / self.scenario.dt * (1.0 - 1e-9), 1.0, 2.0**40)).astype(np.int64)

    def _due(self, mine: Memory, tick: int) -> Mask:
        """Rows whose trainings may be over; while their examples are not known, `ends` is 0."""
        earliest = mine["began"] + self._ticks(mine["slowness"])
        return mine["trains"] & (earliest <= tick) & (mine["ends"] <= tick)

    def _job(self, mine: Memory, row: int) -> Job:
        """The call that trains a row; it is made if this process has not made it yet."""
        uav, began = int(mine["uav"][row]), int(mine["began"][row])
        known, job = self._jobs.get(uav, (-1, None))
        if job is None or known != began:
            job = TRAININGS.submit(self._call(mine, row), self._owners.setdefault(uav, self._new_owner()))
            self._jobs[uav] = began, job
        return job

    def _call(self, mine: Memory, row: int) -> Callable[[], TrainingResult | None]:
        config = self._config(mine, row)
        base, kept, state = (mine[name][row].copy() for name in ("base", "kept", "state"))
        return partial(self._trained, int(mine["uav"][row]), base, kept, _unpacked(state), config)

    def _config(self, mine: Memory, row: int) -> Fit:
        """What the learner of a row knows when its training begins."""
        uav, began = int(mine["uav"][row]), int(mine["began"][row])
        number = began // self.scenario.period_ticks + 1
        return Fit(
            number=number,
            based=int(mine["base_round"][row]),
            seed=self._seed(number, uav),
            time_s=began * self.scenario.dt,
            position=mine["place"][row].copy(),
            whole=bool(mine["base_whole"][row]),
            note=_unpacked(mine["base_heard"][row]),
        )

    def _trained(
        self, uav: int, base: Floats, kept: NDArray[np.uint8], state: bytes, config: Fit
    ) -> TrainingResult | None:
        """Train one model; called in the thread of the trainings."""
        learner, threads = self._learner(uav), started_threads()
        with seeded(config.seed, self._table.threads):
            learner.load(state)
            measured = _numbers("result of `evaluate`", learner.evaluate(self._form.join(base, kept), config))
        with seeded(config.seed, self._table.threads):
            try:
                trained = learner.fit(self._form.join(base, kept), config)
            except TrainingFailed as error:
                return TrainingResult(base, kept, 1.0, {}, b"", b"", str(error), 0)
            state = learner.state()
        if trained is None:
            return None
        if not isinstance(trained, Trained):
            raise TypeError(f"`fit` returns a {type(trained).__name__}; expected mf.Trained(model, examples) or None")
        examples = _number("`examples`", trained.examples)
        check_weights("`examples`", np.array([examples]))
        for label, raw, most in (("note", trained.note, self.note_bytes), ("state", state, self._state_bytes)):
            if not isinstance(raw, bytes) or len(raw) > most:
                given = f"{len(raw)} bytes" if isinstance(raw, bytes) else f"a {type(raw).__name__}"
                raise ValueError(f"its {label} is {given}; `{label}_bytes` declares {most} bytes")
        model, kept = self._form.split(trained.model)
        metrics = measured | _numbers("`metrics` of `fit`", trained.metrics)
        left = max(0, started_threads() - threads)
        return TrainingResult(model, kept, examples, metrics, trained.note, state, self._problem(model), left)

    def _problem(self, model: Floats) -> str:
        if not np.isfinite(model).all():
            return "its trained model is not finite"
        if (largest := float(np.abs(model).max())) >= self._limit:
            return f"its trained model has {largest:g}, beyond what the radio's floats can say"
        return ""

    def _declared(self, name: str) -> Any:
        return getattr(self.options, name, getattr(self.learner, name))

    def _count(self, name: str, least: int, most: int | None = None) -> int:
        return count_of(f"{self._name}: `{name}` is", self._declared(name), least, most)

    def _new_owner(self) -> Owner:
        return Owner(runs_programs=self.learner.runs_programs)

    def _initial(self) -> Tree:
        with seeded(self._seed(_INITIAL, 0), self._table.threads):
            return self.learner.initial(self.options, self.scenario)

    def _learner(self, uav: int) -> Learner:
        """The learner of a UAV."""
        if uav not in self._learners:
            with seeded(self._seed(_INITIAL, uav + 1), self._table.threads):
                self._learners[uav] = self.learner(self.options, self.scenario, uav)
        return self._learners[uav]

    def _seed(self, number: int, uav: int) -> int:
        """Seed of 63 bits, of the scenario, a round and a UAV."""
        words = seeds.generator(self.scenario.seed, "training", number * (self.scenario.uavs + 1) + uav)
        return int(words.integers(2**63))

    def _slowness(self, uav: int) -> float:
        draw = seeds.generator(self.scenario.seed, "slowness", uav)
        return float(np.exp(self._table.spread * draw.standard_normal()))


def _split(memory: Memory) -> tuple[Memory, Memory]:
    """The memories of the controller and of the learner, each with its own names."""
    inner_memory = {name: array for name, array in memory.items() if not name.startswith(PREFIX)}
    mine = {name.removeprefix(PREFIX): array for name, array in memory.items() if name.startswith(PREFIX)}
    return inner_memory, mine


def _numbers(label: str, given: Any) -> dict[str, float]:
    if not isinstance(given, dict):
        raise TypeError(f"{label}: a {type(given).__name__}; expected a dict of numbers by name")
    return {name: _number(f"{label}: {name!r}", value) for name, value in given.items()}


def _number(label: str, given: Any) -> float:
    try:
        return float(given)
    except (TypeError, ValueError) as error:
        raise TypeError(f"{label} is a {type(given).__name__}; expected a number") from error


def _packed(texts: Sequence[bytes], room: int) -> NDArray[np.uint8]:
    """Bytes of at most `room` as rows, each after its length."""
    raw = b"".join(len(text).to_bytes(_SIZE, "little") + text.ljust(room, b"\0") for text in texts)
    return np.frombuffer(raw, np.uint8).reshape(len(texts), _SIZE + room)


def _unpacked(row: NDArray[np.uint8]) -> bytes:
    raw = row.tobytes()
    return raw[_SIZE : _SIZE + int.from_bytes(raw[:_SIZE], "little")]
