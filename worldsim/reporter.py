"""What a run reports: rows of the flight gathered into blocks, events, what was learned, and the summary at the end."""

from collections.abc import Callable, Mapping
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.channel.medium import Medium
from meanflock.federation.post import Post
from meanflock.swarm import state
from meanflock.swarm.model import BEYOND_SENSE
from meanflock.swarm.net import keys
from meanflock.swarm.net.bus import Bus
from meanflock.swarm.state import Floats
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import SWARM_COLUMNS, Act, Event, Finished, FrameKind, Status, Telemetry
from meanflock.worldsim.commands import Commands
from meanflock.worldsim.counters import Counters
from meanflock.worldsim.flight import Flight
from meanflock.worldsim.members import Member
from meanflock.worldsim.outbox import Outbox
from meanflock.worldsim.summary import weight_spread

STATE_LINKS_EVERY_TICKS = 10  # hjb uses N(N−1) links a tick; all their outages are kept, of the rest a sample

Note = Callable[[str, str], None]  # kind and text of an event of this tick

_BLOCK_ROWS, _BLOCK_STATES = 20, 2500  # of a block of telemetry: so many rows, or more of a small swarm
_BLOCK_ROWS_REALTIME = 2
_ARRIVED = bytes([Status.ARRIVED])
_STATE = int(FrameKind.STATE)  # a member of an enumeration is converted anew each time it is compared


class Reporter:
    """The telemetry of one run.

    block: the number of the block that is being filled. events: of that block, but those of the flight in this tick.
    outbox: what is not acknowledged yet.
    """

    def __init__(
        self,
        bus: Bus,
        run: str,
        flight: Flight,
        air: Medium,
        commands: Commands,
        counters: Counters,
        post: Post,
        *,
        block_rows: int | None,
        keeps: bool,
    ) -> None:
        """`block_rows`: of a block at most; None in real time. `keeps`: whether anybody listens."""
        self._bus, self._run, self._fingerprint = bus, run, keys.fingerprint(run)
        self._flight, self._air, self._commands = flight, air, commands
        self._counters, self._post = counters, post
        uavs, self._declared = flight.scenario.uavs, flight.scenario.declared
        rows = _BLOCK_ROWS_REALTIME
        if block_rows is not None:
            rows = max(_BLOCK_ROWS, min(block_rows, _BLOCK_STATES // uavs))
        self._rows = rows
        self._columns: dict[str, Any] = {  # as `Telemetry` has them
            "states": np.zeros((rows, uavs, state.SIZE)),
            "accelerations": np.zeros((rows, uavs, state.AXES), dtype=np.float32),
            "diagnostics": np.zeros((rows, uavs, len(self._declared.diagnostics)), dtype=np.float32),
            "status": np.zeros((rows, uavs), dtype=np.uint8),
            "energy": np.zeros((rows, uavs), dtype=np.float32),
            "swarm": np.zeros((rows, len(SWARM_COLUMNS))),
        }
        self._outages = -1.0  # as of the last row; of none yet, so that the first is looked at
        self.outbox = Outbox(keeps=keeps)
        self.begin(0, 0)

    def begin(self, block: int, first_tick: int) -> None:
        """An empty block, of that number; the tick of its first row."""
        self.block, self._first_tick, self._filled = block, first_tick, 0
        self.events: list[Event] = []
        self._links: list[NDArray[np.int32]] = []
        self._reports: list[tuple[int, Floats, float]] = []

    def note(self, kind: str, text: str) -> None:
        """An event of this tick."""
        self.events.append(Event(self._flight.tick, kind, text))

    def learned(
        self, tick: int, asked: Mapping[str, Member], acts: Mapping[str, Act], alive: NDArray[np.bool_]
    ) -> None:
        """Takes what was learned: the model of the leader's UAV, and how far those of all `alive` (N,) are apart."""
        if not self._declared.weights:
            return
        models = np.full((len(alive), self._declared.weights), np.nan)
        for name, act in acts.items():
            if act.models is not None:
                models[asked[name].place] = act.models
        sane = (np.abs(models) < BEYOND_SENSE).all(axis=-1)  # NaN is below nothing
        if (counted := sane & alive).any():
            spread = self._counters.spread = weight_spread(models if counted.all() else models[counted])
            leader = self._flight.scenario.federation.leader
            self._reports.append((tick, np.where(sane[leader], models[leader], 0.0), spread))

    def add(self, links: NDArray[np.int32]) -> None:
        """The row of this tick, as everything is now, and the `links` (K, 5) that were used; the block before it goes
        out where it is full."""
        flight, meter, counters = self._flight, self._air.meter, self._counters
        if flight.last_arrival == flight.tick:
            meter.mark()
        if self._filled == self._rows:
            self.flush()
        k, columns = self._filled, self._columns
        columns["states"][k] = flight.states
        columns["accelerations"][k] = self._commands.accelerations
        columns["diagnostics"][k] = self._commands.diagnostics
        columns["status"][k] = flight.status
        columns["energy"][k] = flight.energy
        *_, outages, _ = radio = meter.figures()
        columns["swarm"][k] = (
            *radio,
            flight.phi_a,
            flight.phi_c,
            flight.phi_c_distinct or 0.0,
            flight.collisions,
            flight.status.tobytes().count(_ARRIVED),
            self._post.rounds,
            counters.held,
            counters.deadline_misses,
        )
        if len(links) and flight.tick % STATE_LINKS_EVERY_TICKS:
            links = _sample(links, outages > self._outages)
        if len(links):
            self._links.append(links)
        self._outages = outages
        self.events += flight.events
        flight.events = []
        self._filled += 1

    def flush(self, checkpoint: bytes = b"") -> None:
        """Whatever rows there are become a block, with a checkpoint of the last one if there is one."""
        n = self._filled
        ticks, reports, spread = zip(*self._reports, strict=True) if self._reports else ((), (), ())
        self.outbox.add(
            Telemetry(
                run=self._fingerprint,
                block=self.block,
                first_tick=self._first_tick,
                **{name: column[:n].copy() for name, column in self._columns.items()},
                links=np.concatenate([np.zeros((0, 5), dtype=np.int32), *self._links]),
                report_ticks=np.array(ticks, dtype=np.int32),
                reports=np.array(reports, dtype=np.float32).reshape(len(reports), self._declared.weights),
                spread=np.array(spread),
                events=tuple(self.events),
                checkpoint=checkpoint,
                diagnostic_names=self._declared.diagnostics,
            )
        )
        self.begin(self.block + 1, self._first_tick + n)

    def publish(self) -> None:
        """Sends what may be sent now."""
        for raw in self.outbox.next():
            self._bus.put(keys.telemetry(self._run), raw)

    def finish(self, record: dict[str, Any]) -> Finished:
        """The last block, which is the summary."""
        self.flush()
        finished = Finished(self._fingerprint, self.block, msgspec.json.encode(record))
        self.outbox.add(finished)
        return finished

    def repeat(self, finished: Finished) -> None:
        """Sends the summary once more, past everything that was not acknowledged."""
        self._bus.put(keys.telemetry(self._run), control.encode(finished))


def _sample(links: NDArray[np.int32], lost: bool) -> NDArray[np.int32]:
    """All but states that got through; `lost`: whether any did not."""
    if links.item(0, 3) == links.item(-1, 3) == _STATE:  # kinds come one after the other
        return links.compress(links[:, 4] < 0, axis=0) if lost else links[:0]
    return links.compress((links[:, 4] < 0) | (links[:, 3] != _STATE), axis=0)
