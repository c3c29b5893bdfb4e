"""One run in this process and thread: a world, a crew, and outputs."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock.federation.plan import plan_of
from meanflock.net.limits import Limits
from meanflock.swarm.errors import BadInput, PluginFailed
from meanflock.swarm.events import FlightFailed, FlightFinished
from meanflock.swarm.global_generators import DrawWatch
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.threads import limited, renew_if_loaded
from meanflock.swarm.wire.messages import Telemetry
from meanflock.worldsim.checkpoint import EVERY_TICKS, Resumption
from meanflock.worldsim.clocks import Stopwatch, TickSchedule
from meanflock.worldsim.crew import Crew, LocalCrew, Paced, Sink, Watched, fly, move
from meanflock.worldsim.reporting import Blocks, BlockSink, Direct
from meanflock.worldsim.steering import LOCKSTEP, Port, Steered
from meanflock.worldsim.summary import summary
from meanflock.worldsim.tick import Senses
from meanflock.worldsim.world import World

# Of a block of telemetry. Here the recorder runs within a tick, and each call has a cost. A small swarm flies so many
# ticks in a few hundredths of a second.
_BLOCK_ROWS = 100
# UAV ticks between two checkpoints, for the same reason: a checkpoint may wait for the disk five times.
_CHECKPOINT_STATES, _CHECKPOINT_TICKS_AT_MOST = 25_000, 1000


Floats = NDArray[np.float64]
Observer = Callable[["Engine"], None]


class Engine:
    """One run in this process.

    Attributes:
        world: what flies.
        crew: agents and leader.
        watch: the time flown.
    """

    @limited()
    def __init__(
        self,
        scenario: Scenario,
        run: str,
        *,
        uavs_per_node: int | None = None,
        threads: int | None = None,
        sinks: Sequence[BlockSink] = (),
        realtime: float | None = None,
        steer: Port | None = None,
        resume: Resumption | None = None,
        leaders: int | None = None,
        memory: Mapping[str, NDArray[Any]] | None = None,
        is_resumable: bool = True,
    ) -> None:
        """
        Args:
            scenario: what is flown.
            run: name of the run.
            uavs_per_node: UAVs of a node; None: one node has all.
            threads: see `LocalCrew`.
            sinks: get the telemetry; without any, no telemetry is gathered.
            realtime: how many times faster than the wall clock ticks go; None: as fast as they can.
            steer: where clients steer UAVs; only in real time.
            resume: the checkpoint to continue from; None: start at tick 0.
            leaders: one and its standbys; None: as many as the fault script needs.
            memory: arrays of N rows that replace the memory of `init`.
            is_resumable: whether checkpoints go to the sinks; nobody but the caller resumes a stepped flight.

        Raises:
            BadInput: a plug-in cannot be used, the checkpoint does not fit, or lockstep would be steered.
        """
        if steer is not None and realtime is None:
            raise BadInput(LOCKSTEP)
        every = _checkpoint_every(scenario, realtime) if sinks and is_resumable else 0
        draws = DrawWatch()
        plan = plan_of(scenario)
        self.world = World(plan, resume, checkpoint_every=every)
        Limits(plan)  # refuses plug-ins that cannot begin
        self.crew = LocalCrew(
            self.world, resume, rows_at_most=uavs_per_node, threads=threads, leaders=leaders, memory=memory
        )
        self.watch = Stopwatch(self.world.counters.wall_s)
        self._run = run
        self._schedule = None if realtime is None else TickSchedule(realtime, scenario.dt)
        self._answering: Crew = Watched(self.crew, draws)
        if self._schedule is not None:
            self._answering = Paced(self._answering, self._schedule)
        self._blocks: Blocks | None = None
        self._sinks: list[Sink] = []
        self._can_be_steered = steer is not None
        if steer is not None:
            steered = Steered(self._answering, steer, self.world.counters)
            self._answering = steered
            self._sinks.append(steered)
        if sinks:
            self._blocks = Blocks(
                self.world,
                Direct(sinks),
                self.watch,
                block_rows=_BLOCK_ROWS if realtime is None else None,
                block=0 if resume is None else resume.block + 1,
            )
            self._sinks.append(self._blocks)

    def add_sink(self, sink: Sink) -> None:
        """From now on, `sink` gets the rows, too."""
        self._sinks.append(sink)

    def fly(self) -> Iterator[int]:
        """Fly; yields the number of each tick, so that the caller can stop after any.

        Raises:
            PluginFailed: the sinks have the telemetry up to there, and an event says so.
            RunFailed: a sink cannot be written.
        """
        self.watch.restart()
        with self._telling(), limited():
            for row in fly(self.world, self._answering, self._sinks):
                renew_if_loaded()
                yield row.tick
            self.world.flight.books.settle()

    def move(self, senses: Senses) -> None:
        """Fly the tick that was asked for and heard, by the crew's answer. Raises as `fly` does."""
        with self._telling():
            move(self.world, self.crew.speak(senses), self._sinks)

    @contextmanager
    def _telling(self) -> Iterator[None]:
        """Context in which a failure of a plug-in is the last event of the flight."""
        try:
            yield
        except PluginFailed as error:
            self.world.note(FlightFailed(self.world.tick, str(error)))
            self.keep()
            raise

    def keep(self) -> None:
        """Hand all rows to the sinks, of a run that ends without a summary."""
        if self._blocks is not None:
            self._blocks.finish()

    def complete(self, observe: Observer | None = None) -> dict[str, Any]:
        """Fly the whole flight; returns its summary. `observe` is called at take-off and after every tick. It may read
        `world` and `models`, and must not change them.
        """
        if observe is not None:
            observe(self)
        for _ in self.fly():
            if observe is not None:
                observe(self)
        return self.finish()

    @limited()
    def finish(self) -> dict[str, Any]:
        """End the run, also before it is over; returns its summary."""
        world = self.world
        record = summary(
            world,
            self._run,
            "in-process",
            self.watch.seconds,
            schedule=self._schedule,
            can_be_steered=self._can_be_steered,
        )
        if world.over:
            world.note(FlightFinished(world.tick, record["arrived"], world.scenario.uavs))
        self.keep()
        return record

    def states_since(self, blocks: Sequence[Telemetry]) -> Floats:
        """The states (tick + 1, N, 4) of all ticks, of which `blocks` have the first."""
        assert self._blocks is not None
        return np.concatenate([*(block.states for block in blocks), self._blocks.filled])

    @property
    def models(self) -> Floats:
        """Learned weights of every UAV, `(N, W)`; the last ones of a lost UAV."""
        return self.crew.models


def _checkpoint_every(scenario: Scenario, realtime: float | None) -> int:
    """Ticks between checkpoints: a multiple of that of a swarm of processes, or the same in real time."""
    if realtime is not None:
        return EVERY_TICKS
    ticks = min(_CHECKPOINT_TICKS_AT_MOST, _CHECKPOINT_STATES // scenario.uavs)
    return max(EVERY_TICKS, ticks // EVERY_TICKS * EVERY_TICKS)
