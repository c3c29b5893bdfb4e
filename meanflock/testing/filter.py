"""The conformance suite of filters."""

from collections.abc import Sequence
from typing import Any, cast

import msgspec
import numpy as np

from meanflock.agent.controllers.base import Broadcast, Controller, Memory, Received, Step
from meanflock.agent.controllers.filtered import Filter
from meanflock.federation.plan import Plan
from meanflock.swarm import state, threads
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import States
from meanflock.testing.controller import UAVS, check_swarm
from meanflock.testing.error import asked, check_class, copies, fail, make, same, scenarios
from meanflock.testing.pace import SLOW_MS
from meanflock.testing.trial import PointSwarm


class Hasty(Controller):
    """Controller behind the filter: all UAVs fly to one place; it has a model, a diagnostic and a broadcast."""

    name = "hasty"
    period_ticks = 15
    diagnostics = ("frames",)

    def __init__(self, options: Any, scenario: Scenario) -> None:
        super().__init__(options, scenario)
        self.parameters = scenario.dimensions

    def init(self, uavs: Any, plan: States) -> Memory:
        """A model of zeros."""
        return {"model": np.zeros((len(uavs), self.parameters)), "frames": np.zeros(len(uavs))}

    def step(self, memory: Memory, tick: int, own: States, received: Sequence[Received]) -> Step:
        """Flies to the origin and counts received frames."""
        count = memory["frames"].copy()
        for frames in received:
            np.add.at(count, frames.links[:, 1], 1.0)
        push = -2.0 * state.position(own) + 0.01 * memory["model"]
        return Step(memory | {"frames": count}, push, count[:, None], [Broadcast(state.position(own))])

    def get(self, memory: Memory) -> Any:
        """The model."""
        return memory["model"]

    def set(self, memory: Memory, rows: Any, models: Any) -> Memory:
        """The memory with it."""
        model = memory["model"].copy()
        model[rows] = models
        return memory | {"model": model}


@threads.limited()
def check_filter(
    filter_: type[Filter],
    options: dict[str, Any] | None = None,
    scenario: Scenario | None = None,
    slow_ms: float = SLOW_MS,
) -> None:
    """Flies a small swarm of points behind a filter and checks everything that a flight relies on.

    Args:
        filter_: the class. options: those of the table [filter.options]. scenario: default: the paper's with six UAVs,
            in each of the declared dimensions. Its [filter] decides when states are broadcast. slow_ms: limit of the
            median time of a tick of all UAVs.

    Raises:
        ConformanceError: a check fails; the text says what to fix.
    """
    check_class(filter_, "filter")
    for flown in scenarios(filter_, scenario, UAVS):
        _check(filter_, options or {}, flown, slow_ms)


def _check(filter_: type[Filter], given: dict[str, Any], flown: Scenario, slow_ms: float) -> None:
    table = msgspec.structs.replace(flown.filter, kind=filter_.name, options=dict(given))
    flown = msgspec.structs.replace(flown, method=Hasty.name, controller={}, filter=table)

    def instance() -> Any:
        return make(filter_, given, flown, Hasty(Hasty.Options(), flown))

    swarm = PointSwarm(filter_, flown, instance)
    flown = Plan(flown, swarm.declared).scenario  # the controller is not registered
    made = instance()
    swarm.init(made, swarm.uavs)
    _admits(filter_, made, swarm)
    check_swarm(swarm, slow_ms)


def _admits(plugin: type[Filter], instance: Filter, swarm: PointSwarm) -> None:
    """Check `admit`: shapes, no written arguments, and rows that are not finite stay so."""
    uavs, axes = len(swarm.uavs), state.axes(swarm.plan)
    others = np.repeat(swarm.plan[None], uavs, axis=0)
    wanted = np.linspace(-5.0, 5.0, axes * uavs).reshape(uavs, axes)
    given = [swarm.plan.copy(), others, swarm.uavs.copy(), wanted]
    before = copies(given)
    answer = asked(plugin, instance.admit, *given, remedy="any states must do")
    if not isinstance(answer, tuple) or len(answer) != 2:
        fail(
            plugin,
            f"`admit` returns a {type(answer).__name__}",
            "return the accelerations and what is reported of them",
        )
    expected = (uavs, axes), (uavs, len(instance.columns))
    if (shapes := tuple(map(np.shape, answer))) != expected:
        fail(plugin, f"`admit` returns shapes {shapes}, expected {expected}", "return a row a UAV, `columns` wide")
    if not all(same(one, other) for one, other in zip(before, given, strict=True)):
        fail(plugin, "`admit` writes to an array it was given", "return new arrays; copy before you write")
    wanted[0] = np.nan
    with np.errstate(invalid="ignore"):
        admitted, _ = cast(
            Any, asked(plugin, instance.admit, *given, remedy="a command that is no number must do, too")
        )
    if np.isfinite(admitted[0]).all():
        remedy = "let it pass, so that the UAV is lost and not flown by chance"
        fail(plugin, "it returns a finite command for one that is not finite", remedy)
