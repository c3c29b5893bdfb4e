"""The checkpoints of a run: what everyone remembers is collected, kept with the telemetry, and taken up again."""

from collections.abc import Callable
from typing import Any

from meanflock.channel.medium import Medium
from meanflock.swarm import __version__
from meanflock.swarm.errors import BadInput, MessageRejected
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire import control
from meanflock.worldsim import checkpoint
from meanflock.worldsim.barrier import Barrier
from meanflock.worldsim.checkpoint import Memories, Resumption
from meanflock.worldsim.commands import Commands
from meanflock.worldsim.counters import Counters
from meanflock.worldsim.flight import Flight
from meanflock.worldsim.heads import Heads
from meanflock.worldsim.leading import Leading
from meanflock.worldsim.reporter import Reporter

Drop = Callable[[MessageRejected, str], None]


class Checkpoints:
    """All parts of a world that a checkpoint is of."""

    def __init__(
        self,
        scenario: Scenario,
        flight: Flight,
        air: Medium,
        counters: Counters,
        commands: Commands,
        heads: Heads,
        leading: Leading,
        reporter: Reporter,
    ) -> None:
        self._scenario, self._flight, self._air, self._counters = scenario, flight, air, counters
        self._commands, self._heads, self._leading, self._reporter = commands, heads, leading, reporter
        self._memories: Memories | None = None  # where, in the last tick, all were asked for what they remember

    def collect(self, barrier: Barrier, drop: Drop) -> None:
        """Takes what everyone who is not lost replied to a request for it; nothing where somebody did not."""
        memories = Memories(self._scenario.uavs)
        for name, act in barrier.acts.items():
            member = barrier.asked[name]
            if member.rows and act.memory:
                try:
                    memories.take(member, control.decode_record(act.memory))
                except MessageRejected as error:
                    drop(error, f"the memory of {name}")
        self._memories = memories if memories.complete(~self._flight.lost) else None

    def keep(self, wall_s: Callable[[], float]) -> None:
        """A checkpoint, if everyone said what it remembers in the last tick; it goes out with all rows before it.

        `wall_s`: how long the flight has taken so far.
        """
        memories, self._memories = self._memories, None
        if memories is None or self._reporter.outbox.holds_checkpoint:
            return
        body = checkpoint.encode(
            {
                "scenario": self._scenario.sha256(),
                "plugins": [list(plugin) for plugin in self._scenario.plugins()],
                "version": __version__,
                "block": self._reporter.block,
                "flight": self._flight.snapshot(),
                "air": self._air.snapshot(),
                "counters": self._counters.snapshot(wall_s()),
                "uploads": self._leading.uploads.snapshot(),
                "heads": self._heads.snapshot(),
                "commands": self._commands.accelerations,
                "largest": self._commands.largest,
                "summed": self._commands.summed,
                "memory": memories.snapshot(),
                "aggregation": self._leading.aggregation,
            }
        )
        if len(body) <= checkpoint.MAX_BYTES:
            self._reporter.flush(body)

    def restore(self, resume: Resumption) -> None:
        """Goes on from a checkpoint.

        Raises:
            BadInput: it is of another scenario, or of other plug-ins, or incomplete.
        """
        kept: Any = resume.checkpoint
        if kept.get("scenario") != self._scenario.sha256():
            raise BadInput("the checkpoint is of another scenario; resume a run with its own scenario.toml")
        for was, now in zip(kept.get("plugins", ()), self._scenario.plugins(), strict=False):
            if tuple(was) != now:
                raise BadInput(f"the checkpoint is of {was[0]} {was[1]!r} of {was[2]}; here it is of {now[2]}")
        try:
            self._flight.restore(kept["flight"], resume.history)
            self._air.restore(kept["air"])
            self._counters.restore(kept["counters"])
            self._leading.uploads.restore(kept["uploads"])
            self._heads.restore(kept["heads"])
            self._commands.accelerations[...] = kept["commands"]
            self._commands.largest[...] = kept["largest"]
            self._commands.summed[...] = kept["summed"]
            self._leading.aggregation = kept["aggregation"]
            self._reporter.begin(kept["block"] + 1, self._flight.tick + 1)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise BadInput(f"the run cannot be resumed: {error}") from error
