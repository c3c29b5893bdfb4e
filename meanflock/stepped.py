"""`mf.Stepped`: one flight in this process whose UAVs the caller commands, tick by tick."""

import warnings
from collections.abc import Sequence
from contextlib import ExitStack
from functools import cache
from pathlib import Path
from typing import Any, Self, overload

import numpy as np
from numpy.typing import NDArray

from meanflock.agent.controllers.base import Broadcast, Received
from meanflock.agent.controllers.filtered import Filter, of_inner
from meanflock.agent.learning.controller import Learning
from meanflock.agent.step_checks import check_broadcasts
from meanflock.agent.stepped import Command, External, refuse_groups
from meanflock.federation.plan import plan_of
from meanflock.flying import prepared
from meanflock.progress import Progress, checked_progress
from meanflock.results.scenario_name import scenario_name
from meanflock.runs import Run
from meanflock.settings import load_plugins, scenario_of
from meanflock.swarm import threads
from meanflock.swarm.errors import BadInput
from meanflock.swarm.plugins.guard import as_floats, check_finite
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import States

DEFAULT_METHOD = Scenario.__struct_defaults__[Scenario.__struct_fields__.index("method")]


def source_of(scenario: str | Path | Scenario | None) -> Scenario:
    """The scenario of a file, or a shipped one, which is read once: reading takes as long as all else of a take-off."""
    if scenario is None or isinstance(scenario, Scenario):
        return scenario or Scenario()
    return _shipped(scenario) if isinstance(scenario, str) and not Path(scenario).suffix else Scenario.load(scenario)


@cache
def _shipped(name: str) -> Scenario:
    return Scenario.load(name)


class Stepped:
    """A flight that waits for your commands: `step` flies one tick.

        flight = mf.Stepped("paper", seed=7)
        while not flight.over:
            position, velocity = flight.states[:, :2], flight.states[:, 2:]
            flight.step(-0.02 * position - 0.3 * velocity)
        run = flight.finish()

    Faults, radio, meters and records are those of `mf.fly`, and so is the trajectory if you command what a controller
    would. Many flights may interleave in one process. A flight without `out=` can be pickled and deep-copied between
    two steps, and the copy flies on alike.

    scenario: the scenario that is flown; its method is `stepped`. states: (N, 4), a copy of the UAVs' states
    [x, y, vx, vy], in m and m/s. received: the frames that the radio delivered to the UAVs since the last tick. over:
    whether the flight has ended.
    """

    @overload
    def __init__(
        self,
        scenario: str | Path | Scenario | None = "paper",
        *,
        method: str | type | None = None,
        uavs: int | None = None,
        seed: int | None = None,
        duration: float | None = None,
        plugin: str | Path | Sequence[str | Path] | None = None,
        out: str | Path | None = None,
        record: bool = False,
        progress: Progress | None = None,
        parameters: int = 0,
        broadcast_numbers: int = 64,
        **settings: Any,
    ) -> None: ...
    @overload
    def __init__(self, *args: Any, **settings: Any) -> None: ...  # as of `settings.WithSettings`
    def __init__(
        self,
        scenario: str | Path | Scenario | None = "paper",
        *,
        method: str | type | None = None,
        uavs: int | None = None,
        seed: int | None = None,
        duration: float | None = None,
        plugin: str | Path | Sequence[str | Path] | None = None,
        out: str | Path | None = None,
        record: bool = False,
        progress: Progress | None = None,
        parameters: int = 0,
        broadcast_numbers: int = 64,
        **settings: Any,
    ) -> None:
        """Takes off. Further arguments are those of `mf.fly`.

        Args:
            scenario: as for `mf.fly`.
            method: ignored, with a warning, and so are the options of a controller.
            parameters: floats of the model that the UAVs share; 0: there are no rounds.
            broadcast_numbers: most numbers that a UAV broadcasts in a tick, all frames together.
            settings: any dotted scenario key, as in `**{"wind.sigma": 0.2}`.

        Raises:
            BadInput: an argument cannot be used; nothing was flown.
        """
        load_plugins(plugin)
        options = {"parameters": parameters, "broadcast_numbers": broadcast_numbers}
        keys = {key: value for key, value in settings.items() if key.partition(".")[0] != "controller"}
        keys["controller"] = options
        source = source_of(scenario)
        ignored = method or source.method
        if method is not None or ignored not in (DEFAULT_METHOD, External.name):
            name = ignored if isinstance(ignored, str) else getattr(ignored, "__name__", ignored)
            warnings.warn(f"method {name!r} is ignored: `step` commands a stepped flight", stacklevel=2)
        chosen = scenario_of(source, keys, method=External, uavs=uavs, seed=seed, duration=duration)
        refuse_groups(chosen, "a stepped flight")
        self.scenario = plan_of(chosen).given
        self._take_off(out, record, progress, scenario_name(scenario))

    @threads.limited()
    def _take_off(
        self,
        out: str | Path | None = None,
        record: bool = False,
        progress: Progress | None = None,
        mission: str | None = None,
    ) -> None:
        self._tell = checked_progress(progress)
        self._run: Run | None = None
        self._is_closed = False
        with ExitStack() as stack:
            self._flight = prepared(self.scenario, out, record, stack, mission, is_stepped=True)
            self._stack = stack.pop_all()
        self._engine = self._flight.engine
        self._world = self._engine.world
        (agent,) = self._engine.crew.agents
        controller = agent.controller
        self._is_filtered = isinstance(controller, Filter)
        while isinstance(controller, Filter | Learning):
            controller = controller.inner
        self._external = controller
        self._ask()

    @threads.limited()
    def step(
        self,
        acceleration: NDArray[Any],
        broadcasts: Sequence[Broadcast] = (),
        models: NDArray[Any] | None = None,
    ) -> None:
        """Flies one tick.

        A UAV whose row of `acceleration` is not finite is lost, and no other. Afterwards `states` and `received` are
        those of the next tick.

        Args:
            acceleration: (N, 2), m/s².
            broadcasts: frames to send, as in `mf.Step`.
            models: (N, parameters), the models of the UAVs after this tick, from which rounds take the uploads; None:
                the models stay as they are.

        Raises:
            BadInput: an argument has a wrong shape or dtype, or the flight is over; nothing was flown.
            RunFailed: the flight failed.
        """
        if self.over:
            raise BadInput("the flight is over; make another mf.Stepped")
        assert isinstance(self._external, External)
        self._external.command = self._checked(acceleration, broadcasts, models)
        self._engine.move(self._senses)
        if self.tick % 100 == 0:
            self._tell(self.tick, self.scenario.max_ticks)
        self._ask()

    @property
    def tick(self) -> int:
        """Number of ticks flown."""
        return self._world.flight.tick

    @property
    def models(self) -> NDArray[np.float64]:
        """(N, parameters), the models of the UAVs; a global model that has arrived has replaced a UAV's own."""
        return self._engine.models.copy()

    def finish(self) -> Run:
        """Ends the flight, also before it is over, and completes its files; returns the run, as `mf.fly` does.

        Raises:
            BadInput: `close` has abandoned the flight.
        """
        if self._run is None:
            if self._is_closed:
                raise BadInput("finish: `close` has abandoned the flight; make another mf.Stepped, and finish it first")
            self.over = True
            with self._stack:
                self._run = self._flight.finish()
        return self._run

    def close(self) -> None:
        """Abandons the flight. Only needed with `out=`: its folder has the ticks that were flown."""
        self.over = self._is_closed = True
        outputs = self._flight.outputs
        with self._stack:
            if outputs is not None and outputs.folder.is_owner:  # a fork writes nothing of its parent
                self._engine.keep()

    def __getstate__(self) -> dict[str, Any]:
        """The flight, with the states of all ticks in place of their hash, which no pickle or copy can have.

        Raises:
            BadInput: the flight has files.
        """
        if self._flight.outputs is not None:
            raise BadInput("a flight with out= cannot be copied: two flights would write its files; leave out= out")
        self._world.flight.books.settle()
        return self.__dict__ | {"_history": self._engine.states_since(self._flight.memory.blocks)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        history = state.pop("_history")
        self.__dict__.update(state)
        self._world.flight.books.rehash(history)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *failure: object) -> None:
        self.close()

    def _ask(self) -> None:
        """Begin the next tick, if there is one."""
        self.over = self._world.over
        self.received: tuple[Received, ...] = ()
        if not self.over:
            self._senses = self._world.ask()
            self._engine.crew.hear(self._senses)
            for received in self._engine.crew.received:  # of the one agent, if a UAV is awake
                self.received = of_inner(received) if self._is_filtered else received
        self.states: States = self._world.flight.states.copy()

    def _checked(self, acceleration: Any, broadcasts: Any, models: Any) -> Command:
        uavs, declared = self.scenario.uavs, plan_of(self.scenario).declared
        try:
            commanded = as_floats("acceleration", acceleration, (uavs, self.scenario.dimensions))
            check_broadcasts(broadcasts, uavs, declared)
            if models is not None:
                models = as_floats("models", models, (uavs, declared.parameters))
                check_finite("models", models)
        except (TypeError, ValueError) as error:
            raise BadInput(f"step: {error}; nothing was flown") from error
        return Command(commanded, broadcasts, models)
