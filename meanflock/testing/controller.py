"""The conformance suite of controllers."""

from contextlib import suppress
from typing import Any

import msgspec
import numpy as np

from meanflock.agent.controllers.base import Controller
from meanflock.federation.codec import check_weights
from meanflock.federation.plan import Plan
from meanflock.swarm import declared, threads
from meanflock.swarm.plugins.guard import check_bounded
from meanflock.swarm.scenario import Scenario
from meanflock.testing.error import (
    GONE,
    OTHER_THREADS,
    THREADS,
    alike,
    asked,
    check_class,
    check_same_form,
    copies,
    fail,
    make,
    same,
    scenarios,
    without_draws,
)
from meanflock.testing.pace import SLOW_MS, check_pace
from meanflock.testing.trial import PURE, RANDOM, PointSwarm, Trial

UAVS = 6
_BATTERY_J = 1e6  # so that goals may change in flight

_ROWS = "compute every row from that row of `own` and `memory`, and from the frames linked to it in `received`, alone"
_GUIDE = "return the memory in which the rows `rows` have the goals `goals`, a row each"


@threads.limited()
def check_controller(
    controller: type[Controller],
    options: dict[str, Any] | None = None,
    scenario: Scenario | None = None,
    slow_ms: float = SLOW_MS,
) -> None:
    """Flies a small swarm of points with a controller and checks everything that a flight relies on.

    The swarm flies two rounds of a controller that shares a model, and 40 ticks at least. It flies 205 ticks twice, to
    find a controller that draws an unseeded number late. A controller that is `guided` gets other goals.

    Args:
        controller: the class. options: those of the table [controller]. scenario: default: the paper's with six UAVs,
            in each of the declared dimensions. slow_ms: limit of the median time of a tick of all UAVs.

    Raises:
        ConformanceError: a check fails; the text says what to fix.
    """
    check_class(controller, "controller")
    for flown in scenarios(controller, scenario, UAVS):
        _check(controller, options or {}, flown, slow_ms)


def _check(controller: type[Controller], options: dict[str, Any], flown: Scenario, slow_ms: float) -> None:
    flown = msgspec.structs.replace(flown, method=controller.name, controller=dict(options))

    def swarm_of(flown: Scenario) -> PointSwarm:
        """A swarm of the controller, which is made as a flight does, behind the scenario's filter."""

        def instance() -> Controller:
            alone: Controller = make(controller, options, flown)
            behind: Controller = declared.filtered(alone, flown)
            return behind

        return PointSwarm(controller, flown, instance)

    swarm = swarm_of(flown)
    flown = Plan(flown, swarm.declared).scenario  # the class need not be registered under its name
    check_swarm(swarm, slow_ms)
    if swarm.declared.guided:
        battery = msgspec.structs.replace(flown.energy, battery_J=_BATTERY_J)
        with without_draws(controller, RANDOM):
            _guided(swarm_of(msgspec.structs.replace(flown, energy=battery)))
    with suppress(ModuleNotFoundError):  # the package `channel` is not installed with agents only
        from meanflock.channel.outlook import warn_of_lost_models

        warn_of_lost_models(flown)


def check_swarm(swarm: PointSwarm, slow_ms: float) -> None:
    """Check everything that a flight relies on.

    Raises:
        ConformanceError: a check fails; the text says what to fix.
    """
    with without_draws(swarm.controller, RANDOM):
        _silence(swarm)
        _empty_rows(swarm)
        _quick(swarm, slow_ms)
        together = swarm.trial()
        _pure(swarm)
        _models(swarm, together)
    _deterministic(swarm, together)
    _rows_alone(swarm, together)
    _side_by_side(swarm, together)
    _checkpointed(swarm, together)


def _empty_rows(swarm: PointSwarm) -> None:
    """Check that arrays without rows have the right shapes."""
    instance, none = swarm.make(), np.zeros((0, swarm.plan.shape[1]))
    memory = swarm.init(instance, swarm.uavs[:0])
    swarm.checked(swarm.step(instance, memory, 0, none, ()), memory, 0)


def _silence(swarm: PointSwarm) -> None:
    """Fly without received frames."""
    instance = swarm.make()
    memory = swarm.init(instance, swarm.uavs)
    for tick in range(3):
        step = swarm.step(instance, memory, tick, swarm.plan, ())
        swarm.checked(step, memory, len(swarm.uavs))
        memory = step.memory


def _pure(swarm: PointSwarm) -> None:
    """Check that no argument is written to."""
    instance = swarm.make()
    memory = swarm.init(instance, swarm.uavs)
    own = swarm.plan + 0.5
    first = swarm.step(instance, memory, 1, own.copy(), ())
    received = swarm.received(first, swarm.uavs, np.ones((len(own), len(own)), bool))
    memory = first.memory
    given = [own, *memory.values(), *(array for frames in received for array in (frames.payload, frames.links))]
    before = copies(given)
    swarm.step(instance, memory, 2, own, received)
    if not all(same(one, other) for one, other in zip(before, given, strict=True)):
        fail(swarm.controller, "`step` writes to an array it was given", PURE)


def _deterministic(swarm: PointSwarm, together: Trial) -> None:
    """Check that flights are equal with other seeds of the global generators, and with other numbers of threads."""
    first = together if len(together.commands) == swarm.long else swarm.trial(ticks=swarm.long)
    if (difference := first.differs(swarm.trial(seed=2, ticks=swarm.long))) is not None:
        fail(swarm.controller, f"the same flight differed in a second run, in tick {difference}", RANDOM)
    if together.differs(swarm.trial(number=OTHER_THREADS)) is not None:
        fail(swarm.controller, *THREADS)


def _rows_alone(swarm: PointSwarm, together: Trial) -> None:
    """Check that rows fly the same with an instance each."""
    if (difference := together.differs(swarm.trial(alone=True))) is not None:
        fail(
            swarm.controller,
            f"a UAV flies differently with others in one process than alone, from tick {difference} on",
            _ROWS,
        )


def _side_by_side(swarm: PointSwarm, together: Trial) -> None:
    """Check that two flights in two threads at once are equal, as agents of a large swarm fly in one process."""
    differences = [together.differs(trial) for trial in swarm.side_by_side()]
    if (found := [tick for tick in differences if tick is not None]) != []:
        fail(
            swarm.controller,
            f"two instances that fly in two threads at once differ from one alone, from tick {min(found)} on",
            "keep what changes in the memory or in the instance, or guard it by a lock",
        )


def _checkpointed(swarm: PointSwarm, together: Trial) -> None:
    """Check a flight with a new instance in every tick, which gets only the memory, encoded and decoded."""
    afresh = swarm.trial(afresh=True)
    if (difference := together.differs(afresh)) is not None:
        fail(swarm.controller, f"a flight that continues from a checkpoint differs in tick {difference}", GONE)


def _models(swarm: PointSwarm, together: Trial) -> None:
    """Check that `set` stores models in the given rows, and `get` returns them."""
    instance = swarm.make()
    swarm.init(instance, swarm.uavs)
    parameters, plugin, uavs = swarm.declared.parameters, swarm.controller, len(swarm.uavs)
    for called, method, expected, check in (
        ("report", instance.report, (uavs, swarm.declared.weights), check_bounded),
        ("samples", instance.samples, (uavs,) if swarm.declared.weighted else (0,), check_weights),
    ):
        if expected[-1]:
            remedy = f"return one row a UAV, {expected[1]} wide" if len(expected) > 1 else "return one number a UAV"
            table = asked(plugin, method, together.memory, remedy=remedy)
            if np.shape(table) != expected:
                fail(plugin, f"`{called}` returns shape {np.shape(table)}, expected {expected}", remedy)
            swarm.check(called, table, check)
    if not parameters:
        return
    rows = np.array([0, uavs - 1])
    models = np.stack([np.linspace(-1.0, 1.0, parameters)] * 2)
    before = {name: array.copy() for name, array in together.memory.items()}
    after = swarm.set(instance, together.memory, rows, models)
    if (written := alike(before, together.memory)) is not None:
        fail(plugin, f"`set` writes to memory[{written!r}]", PURE)
    got, had = (swarm.models([instance], [memory]) for memory in (after, together.memory))
    if not np.allclose(got[rows], models):
        fail(plugin, "`get` does not return what was `set`", "store the model in the memory")
    if not same(np.delete(got, rows, axis=0), np.delete(had, rows, axis=0)):
        fail(plugin, "`set` changes other rows than `rows`", "write to `rows` only")


def _guided(swarm: PointSwarm) -> None:
    """Check that `guide` gives other goals to the given rows, each by itself, and changes no other row."""
    plugin, memory = swarm.controller, swarm.trial(ticks=3).memory
    rows = np.array([0, len(swarm.uavs) - 1])
    goals = swarm.plan[rows, : swarm.plan.shape[1] // 2] + 25.0
    instance = swarm.make()
    swarm.init(instance, swarm.uavs)
    given = [rows, goals, *memory.values()]
    before = copies(given)
    after = asked(plugin, instance.guide, memory, rows, goals, remedy=_GUIDE)
    if not all(same(one, other) for one, other in zip(before, given, strict=True)):
        fail(plugin, "`guide` writes to an array it was given", PURE)
    check_same_form(plugin, "`guide`: memory", after, memory)
    single = {name: array[:1] for name, array in memory.items()}
    after_alone = asked(plugin, instance.guide, single, rows[:1], goals[:1], remedy=_GUIDE)
    for name, array in memory.items():
        if not same(np.delete(after[name], rows, axis=0), np.delete(array, rows, axis=0)):
            fail(plugin, f"`guide` changes other rows of memory[{name!r}] than `rows`", "write to `rows` only")
        if not same(after[name][:1], after_alone[name]):
            fail(plugin, f"`guide` gives a UAV another memory[{name!r}] with others than alone", _GUIDE)


def _quick(swarm: PointSwarm, slow_ms: float) -> None:
    instance = swarm.make()
    memory = swarm.init(instance, swarm.uavs)

    def tick(number: int) -> None:
        nonlocal memory
        step = swarm.step(instance, memory, number, swarm.plan, ())
        swarm.checked(step, memory, len(swarm.uavs))
        memory = step.memory

    check_pace(swarm.controller, f"a tick of {len(swarm.uavs)} UAVs", slow_ms, tick)
