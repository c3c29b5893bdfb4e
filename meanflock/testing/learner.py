"""The conformance suite of learners."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meanflock.agent.controllers.base import Arrival, Memory
from meanflock.agent.learning.base import Learner
from meanflock.agent.learning.controller import PREFIX, Learning
from meanflock.federation.plan import Plan
from meanflock.swarm import declared, plugins, threads
from meanflock.swarm.errors import FAILURES, BadInput, last_line
from meanflock.swarm.events.nodes import FailedTraining
from meanflock.swarm.mission import starts
from meanflock.swarm.plugins import registry
from meanflock.swarm.scenario import Scenario, as_builtins
from meanflock.swarm.wire.control import FLOAT_OF_BITS, decode_record, encode_record
from meanflock.testing.error import OTHER_THREADS, alike, check_class, fail, same, with_surroundings

UAVS, METHOD = 4, "plan"
ROUNDS, HOP = 2, 2  # rounds of a trial; ticks from an upload to the arrival of the global model

_RANDOM = "draw from the global generators, which are seeded, or from a generator of `config.seed`"
_OUTSIDE = "draw in `initial`, `fit` and `evaluate` only, for which they are seeded"
_ALONE = "train from the arguments of `fit`, and share nothing that changes between the learners of a process"
_THREADS = "leave the number of threads as it is: `training.threads` sets it before each call"
_HIDDEN = (
    "what `fit` leaves in `self` is gone after a checkpoint: return it from `state`, take it in `load`, and declare "
    "`state_bytes`"
)


class LearningTrial(NamedTuple):
    """Record of a trial: the models that were uploaded in each round, and the memory at the end."""

    uploads: list[NDArray[np.float64]]
    memory: Memory

    def differs(self, other: "LearningTrial") -> str:
        """The first difference of two trials; empty if they are equal."""
        for number, (one, its) in enumerate(zip(self.uploads, other.uploads, strict=True), 1):
            if not same(one, its):
                return f"the models of round {number}"
        name = alike(self.memory, other.memory)
        return "" if name is None else f"the {name.removeprefix(PREFIX)} at the end"


@threads.limited()
def check_learner(
    learner: type[Learner], options: dict[str, Any] | None = None, scenario: Scenario | None = None
) -> None:
    """Trains a small swarm in two rounds and checks everything that a flight relies on.

    The rounds are repeated with a learner for each UAV alone, with other threads in the process, and from checkpoints
    before and during a training. A learner that draws from an unseeded generator is found.

    Args:
        learner: the class. options: those of the table [training.options]. scenario: default: the paper's with four
            UAVs that fly `plan`; its method must share no model.

    Raises:
        ConformanceError: a check fails; the text says what to fix.
    """
    check_class(learner, "learner")
    flown = scenario or Scenario(uavs=UAVS, method=METHOD)
    with _registered(learner):
        given = as_builtins(dict(options or {}))
        try:
            flown = Plan(flown.replace(**{"training.learner": learner.name, "training.options": given})).scenario
        except BadInput as error:
            fail(learner, str(error), "no flight takes it")
        uavs = np.arange(flown.uavs)
        together = [uavs]
        first = _trial(learner, flown, together)
        for again, problem, remedy in (
            (_trial(learner, flown, together, seed=2), "differ in a second run", _RANDOM),
            (_trial(learner, flown, [uavs[k : k + 1] for k in uavs]), "differ if each UAV is alone", _ALONE),
            (_trial(learner, flown, together, afresh=True), "differ after a checkpoint", _HIDDEN),
            (_trial(learner, flown, together, number=OTHER_THREADS), "differ if other code has two threads", _THREADS),
        ):
            if difference := first.differs(again):
                fail(learner, f"{difference} {problem}", remedy)


@contextmanager
def _registered(learner: type[Learner]) -> Iterator[None]:
    """Context in which the learner is found by its name."""
    key: tuple[plugins.PluginKind, str] = ("learner", learner.name)
    before = registry.registered.get(key)
    if not any((plugin.kind, plugin.name) == key for plugin in plugins.installed()):
        plugins.register(learner)
    try:
        yield
    finally:
        if before is None:
            registry.registered.pop(key, None)


def _trial(
    learner: type[Learner],
    flown: Scenario,
    groups: list[NDArray[np.intp]],
    seed: int = 1,
    number: int = 1,
    afresh: bool = False,
) -> LearningTrial:
    """Train in some rounds with an instance for each group of UAVs.

    Args:
        seed: of the global generators. number: of threads of the numeric libraries, outside of trainings. afresh: a new
            instance, which gets only the memory, when a model arrives and one tick later.
    """
    return with_surroundings(learner, _OUTSIDE, lambda: _rounds(learner, flown, groups, afresh), seed, number)


def _rounds(learner: type[Learner], flown: Scenario, groups: list[NDArray[np.intp]], afresh: bool) -> LearningTrial:
    period, plan = flown.period_ticks, starts(flown)
    instances = [_made(flown) for _ in groups]
    memories = [_asked(learner, one.init, group, plan) for one, group in zip(instances, groups, strict=True)]
    uploads: list[NDArray[np.float64]] = []
    models = instances[0].get(memories[0])[0]
    for tick in range(ROUNDS * period + HOP + 2):
        number, since = divmod(tick, period)
        if number and since == 0:
            uploads.append(_upload(learner, flown, instances, memories))
            models = uploads[-1].mean(axis=0)
        for k, group in enumerate(groups):
            memory = memories[k]
            if afresh and tick and since in ((HOP, HOP + 1) if number else (1,)):
                instances[k] = _made(flown)
                raw = encode_record({name: np.ascontiguousarray(array) for name, array in memory.items()})
                memory = {name: np.array(array) for name, array in decode_record(raw).items()}
            if number and since == HOP:
                rows = np.arange(len(group))
                arrival = Arrival(number, np.tile(models, (len(rows), 1)), rows >= 0, [b""] * len(rows))
                memory = instances[k].arrived(memory, rows, arrival)
            step = _asked(learner, instances[k].step, memory, tick, plan[group], ())
            if lost := [one for one in step.news if isinstance(one, FailedTraining)]:
                fail(learner, lost[0].failure, "guard divisions and roots, and take smaller steps")
            memories[k] = step.memory
    return LearningTrial(uploads, {name: np.concatenate([one[name] for one in memories]) for name in memories[0]})


def _upload(
    learner: type[Learner], flown: Scenario, instances: list[Learning], memories: list[Memory]
) -> NDArray[np.float64]:
    """The models of all UAVs that have one, as floats of the radio."""
    found = [one.get(memory)[one.ready(memory)] for one, memory in zip(instances, memories, strict=True)]
    models = np.concatenate(found)
    if not len(models):
        fail(learner, "no UAV has trained a model in a round", "return mf.Trained(model, examples) from `fit`")
    return models.astype(FLOAT_OF_BITS[flown.radio.bits_per_float]).astype(np.float64)


def _made(flown: Scenario) -> Learning:
    """The learner around its controller, as in a flight without a filter."""
    inner = plugins.create("controller", flown.method, flown.controller, flown)
    made: Learning = declared.learning(inner, flown)
    return made


def _asked(learner: type[Learner], method: Any, *given: Any) -> Any:
    try:
        return method(*given)
    except FAILURES as error:
        fail(learner, last_line(error), "fix it")
