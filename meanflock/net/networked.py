"""One run whose nodes are on a bus: a world, its crew, telemetry and a summary."""

import time
from collections.abc import Callable, Iterator
from typing import Any

from meanflock.federation.plan import plan_of
from meanflock.net.bus import Bus
from meanflock.net.limits import Limits
from meanflock.net.outbox import Outbox
from meanflock.net.remote import RemoteCrew
from meanflock.swarm.errors import BadInput, RunFailed
from meanflock.swarm.events import FlightFailed, FlightFinished
from meanflock.swarm.global_generators import DrawWatch
from meanflock.swarm.scenario import Scenario
from meanflock.worldsim.checkpoint import EVERY_TICKS, Resumption
from meanflock.worldsim.clocks import Stopwatch, TickSchedule
from meanflock.worldsim.crew import Crew, Sink, Watched, fly
from meanflock.worldsim.reporting import BLOCK_ROWS, Blocks
from meanflock.worldsim.steering import LOCKSTEP, Port, Steered
from meanflock.worldsim.summary import summary
from meanflock.worldsim.world import World

MODE = "processes"
FAILED_S = 5.0  # wait for a recorder after a failure


class NetworkedRun:
    """One run, from the first node that joins to the summary.

    Attributes:
        run: its name.
        world: what flies.
        nodes: agents and leader.
        outbox: telemetry that no ground station has acknowledged.
        watch: the time flown.
        sinks: get the rows; more may be added before take-off.
    """

    def __init__(
        self,
        scenario: Scenario,
        bus: Bus,
        run: str,
        resume: Resumption | None = None,
        *,
        limits: Limits | None = None,
        stations: int = 0,
        barrier_s: float = 10.0,
        realtime: float | None = None,
        steer: Port | None = None,
        rows_at_most: int | None = None,
        checkpoint_every: int = EVERY_TICKS,
        block_rows: int = BLOCK_ROWS,
        cancelled: Callable[[], bool] = lambda: False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """
        Args:
            scenario: what is flown.
            bus: carries the messages.
            run: name of the run.
            resume: the checkpoint to continue from; None: start at tick 0.
            limits: the longest messages, if the caller has them already.
            stations: ground stations that must listen before the first tick.
            barrier_s: how long a tick waits for a node before the node is lost.
            realtime: how many times faster than the wall clock ticks go; None: as fast as they can.
            steer: where clients steer UAVs; only in real time.
            rows_at_most: most UAVs that an agent may hold; None: any number.
            checkpoint_every: ticks between two checkpoints, a multiple of ten; 0 for none.
            block_rows: most rows of a block of telemetry in lockstep.
            cancelled: whether nobody waits for the flight any more; asked while nodes are missing.
            clock: seconds, monotonic.

        Raises:
            BadInput: a plug-in cannot be used, the checkpoint does not fit, or lockstep would be steered.
        """
        if steer is not None and realtime is None:
            raise BadInput(LOCKSTEP)
        self.run = run
        draws = DrawWatch()
        plan = plan_of(scenario)
        self.world = World(plan, resume, checkpoint_every=checkpoint_every)
        self.outbox = Outbox(bus, run)
        self.watch = Stopwatch(self.world.counters.wall_s, clock)
        self.sinks: list[Sink] = []
        self._schedule = None if realtime is None else TickSchedule(realtime, scenario.dt)
        self._rows = block_rows if realtime is None else None
        self._block = 0 if resume is None else resume.block + 1
        self._can_be_steered = steer is not None
        self._blocks: Blocks | None = None
        self.nodes = RemoteCrew(
            self.world,
            bus,
            run,
            resume,
            limits=limits or Limits(plan),
            outbox=self.outbox,
            stations=stations,
            barrier_s=barrier_s,
            schedule=self._schedule,
            rows_at_most=rows_at_most,
            cancelled=cancelled,
            clock=clock,
        )
        self._crew: Crew = Watched(self.nodes, draws)
        if steer is not None:
            self._crew = steered = Steered(self._crew, steer, self.world.counters, clock)
            self.sinks.append(steered)

    def gather(self, timeout_s: float) -> None:
        """See `RemoteCrew.gather`."""
        self.nodes.gather(timeout_s)

    def fly(self) -> Iterator[int]:
        """Fly; yields the number of each tick, so that the caller can stop after any.

        Raises:
            RunFailed: the vehicle failed, or all agents are lost and none came back; all nodes were stopped.
        """
        self.watch.restart()
        self._blocks = Blocks(self.world, self.outbox, self.watch, block_rows=self._rows, block=self._block)
        try:
            for row in fly(self.world, self._crew, [*self.sinks, self._blocks]):
                yield row.tick
            self.world.flight.books.settle()
        except RunFailed as error:
            self.world.learn(*self.nodes.last_news())
            self.world.note(FlightFailed(self.world.tick, str(error)))
            self._blocks.finish()
            self.nodes.leave(str(error), lambda: FAILED_S)
            raise

    def finish(self, linger_s: Callable[[], float] = lambda: 10.0) -> dict[str, Any]:
        """End the run: make the summary, stop all nodes, hand over the telemetry.

        `linger_s`: how long the world waits for a station that acknowledges nothing; asked again and again.
        """
        assert self._blocks is not None
        record = summary(
            self.world,
            self.run,
            MODE,
            self.watch.seconds,
            schedule=self._schedule,
            can_be_steered=self._can_be_steered,
            blocks_dropped=self.outbox.dropped,
        )
        if self.world.over:
            self.world.note(FlightFinished(self.world.tick, record["arrived"], self.world.scenario.uavs))
        self.outbox.finish(self._blocks.finish(), record)
        self.nodes.leave("finished", linger_s)
        if self.outbox.waiting:
            self.outbox.repeat_summary()
        return record
