"""The flight as a Rerun recording: written to a file, served to viewers.

`Writer` alone sends, in batches: the rows that `flight.py`, `plots.py` and `disturbances.py` make of telemetry, and
the fixed parts of `blueprint.py` and `mission_map.py`. `replay.py` reads recordings back. Memory keeps only Rerun's
index of the file, which becomes its footer: some 70 KB a batch.
"""

import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from threading import Thread
from types import TracebackType

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray
from rerun_bindings import flush_and_cleanup_orphaned_recordings

from meanflock.federation.plan import plan_of
from meanflock.recording import blueprint, mission_map, space
from meanflock.recording.branches import IN_SPACE, ON_MAP
from meanflock.recording.disturbances import Disturbances
from meanflock.recording.drawing import Part, Sent, Ticks
from meanflock.recording.flight import (
    Trails,
    event_rows,
    group_colors,
    link_rows,
    mark_rows,
    uav_colors,
    uav_rows,
    with_stations,
)
from meanflock.recording.plots import plot_rows, report_rows
from meanflock.recording.rounds import RoundRows
from meanflock.recording.viewer import await_listener, listening_address
from meanflock.results.disk import LARGE_SWARM, LARGE_SWARM_STRIDE
from meanflock.results.series import Reported
from meanflock.swarm import durable, mission, state
from meanflock.swarm.errors import RunFailed
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import Telemetry

APPLICATION = "meanflock"
BATCH_TICKS = 500  # rows sent at once; with fewer rows, headers and calls dominate:
_BATCH_STATES, _BATCH_TICKS_AT_MOST = 50_000, 2000  # more of a small swarm
BATCH_WALL_S = 0.5  # longest delay for a live viewer
FILE_WALL_S = 2.0  # longest time that is lost in a kill, and replayed
_LATE_VIEWERS = "256MB"  # memory of the server for viewers; beyond it, the oldest data go
CLOSE_WALL_S = 10.0  # only the footer is written in this time

Sink = rr.FileSink | rr.GrpcServerSink


class Writer:
    """Sends one flight's telemetry to a recording that the caller opens and closes.

    Args:
        scenario: what is flown.
        stream: the recording.
        reported: what the controller reports; None: what its class declares.
        part: prefix of all entities of the flight; empty if the recording has one flight.
        patience_s: longest time that rows wait, wall clock.
        maps: number of maps in the same window.

    Raises:
        BadInput: the class is not installed here.
    """

    def __init__(
        self,
        scenario: Scenario,
        stream: rr.RecordingStream,
        reported: Reported | None = None,
        part: str = "",
        patience_s: float = FILE_WALL_S,
        maps: int = 1,
    ) -> None:
        self._reported = reported if reported is not None else Reported.by(plan_of(scenario))
        self._scenario = scenario
        self._part = f"{part}/" if part else ""
        self._maps = maps
        self._large = scenario.uavs > LARGE_SWARM
        self._disturbances = Disturbances(scenario)
        self._branches = [ON_MAP, IN_SPACE] if scenario.space.dimensions == state.SPACE else [ON_MAP]
        self._trails = {branch: Trails(scenario, branch) for branch in self._branches}
        self._rounds = RoundRows(scenario)
        self._pending: list[Telemetry] = []
        self._pending_ticks = 0
        self._batch_ticks = min(_BATCH_TICKS_AT_MOST, max(BATCH_TICKS, _BATCH_STATES // scenario.uavs))
        self._sent_at = time.monotonic()
        self._patience_s = patience_s
        self._index_of: Ticks = np.empty(0, dtype=np.int64)
        self._index: tuple[rr.TimeColumn, ...] = ()
        self._stream: rr.RecordingStream | None = stream
        self._under = Part(stream, self._part)

    def log_fixed(self) -> None:
        """Logs what does not change in flight."""
        blueprint.log_static(self._under, self._scenario, self._reported)
        mission_map.log(self._under, self._scenario, self._reported, self._maps)
        if IN_SPACE in self._branches:
            space.log(self._under, self._scenario, self._maps)

    def write(self, block: Telemetry) -> None:
        """Records a block of T ≥ 1 ticks. Blocks come in the order of the flight; one may be missing."""
        if self._stream is None:
            raise ValueError("the recording is closed")
        self._pending.append(block)
        self._pending_ticks += len(block.states)
        if self._pending_ticks >= self._batch_ticks or time.monotonic() - self._sent_at >= self._patience_s:
            self.flush()

    def flush(self) -> None:
        """Sends the rows that `write` has gathered."""
        if self._stream is not None and self._pending:
            blocks = self._pending
            self._pending = []
            self._pending_ticks = 0
            self._sent_at = time.monotonic()
            self._send_blocks(blocks)

    def _send_blocks(self, blocks: list[Telemetry]) -> None:
        """Sends blocks of telemetry, which follow each other."""
        ticks = np.concatenate([block.first_tick + np.arange(len(block.states)) for block in blocks])
        states = np.concatenate([block.states for block in blocks])
        diagnostics = np.concatenate([block.diagnostics for block in blocks])
        swarm = np.concatenate([block.swarm for block in blocks])
        status = np.concatenate([block.status for block in blocks])
        energy = np.concatenate([block.energy for block in blocks])
        links = np.concatenate([block.links for block in blocks])
        events = [event for block in blocks for event in block.events]
        positions = state.position(states).astype(np.float32)
        computed = None
        if self._scenario.groups or any(block.has_diagnostic is not None for block in blocks):
            computed = self._computed(ticks, blocks)
        if self._scenario.groups:
            colors = group_colors(self._scenario, ticks, status)
        else:
            colors = uav_colors(states, diagnostics, status, self._reported)

        chosen = (ticks % LARGE_SWARM_STRIDE == 0).nonzero()[0] if self._large else slice(None)
        rows = ticks[chosen]
        rows = ticks if len(rows) == len(ticks) else rows
        for branch in self._branches:
            places = branch.within(positions)
            if len(rows):
                leader = self._scenario.federation.leader
                self._send(uav_rows(branch, rows, states[chosen], colors[chosen], leader))
            self._send(self._trails[branch].rows(ticks, places, colors))
            self._send(link_rows(branch, ticks, with_stations(places, self._scenario), links))
            self._send(mark_rows(branch, ticks, places, events))
        if len(rows):
            self._send(self._disturbances.rows(rows, states[chosen]))
            if IN_SPACE in self._branches:
                self._send(space.rows(rows, positions[chosen]))
        self._send(self._rounds.rows(ticks, links, events, status))
        self._send(report_rows(blocks, self._reported))
        self._send(event_rows(ticks, swarm, events))
        if not self._large:
            self._send(self._disturbances.lanes(ticks, status))
        names = self._reported.diagnostics
        groups = [rows for _, rows in mission.parts(self._scenario)]
        self._send(plot_rows(ticks, states, diagnostics, swarm, energy, status, names, computed, groups))

    def _computed(self, ticks: Ticks, blocks: Sequence[Telemetry]) -> NDArray[np.bool_]:
        """Mask (T, N, K) of the diagnostics that UAVs have computed: those they have, once they have joined."""
        joined = ticks[:, None] > mission.joins(self._scenario)
        has = [
            np.broadcast_to(True if block.has_diagnostic is None else block.has_diagnostic > 0, block.diagnostics.shape)
            for block in blocks
        ]
        return joined[..., None] & np.concatenate(has)

    def _send(self, sent: Iterable[Sent]) -> None:
        for entity, ticks, columns in sent:
            if ticks is not self._index_of:  # most columns of a batch have all its ticks
                duration = rr.TimeColumn(blueprint.TIMELINE, duration=ticks * self._scenario.dt)
                self._index_of, self._index = ticks, (duration, rr.TimeColumn(blueprint.TICKS, sequence=ticks))
            rr.send_columns(self._part + entity, self._index, columns, recording=self._stream)


class Recorder(Writer):
    """Writes a run's telemetry to a file, to live viewers, or both.

    Args:
        scenario: what is flown.
        run_id: name of the recording.
        path: the `.rrd` file to write; an existing one is replaced. None: no file.
        serve: address and port on which viewers find the recording, also when they come late; port 0 takes
            a free one. None: not served.
        reported: what the controller reports; None: what its class declares.

    Raises:
        BadInput: the file cannot be written, the address cannot be listened on, or the class is not installed here.
    """

    def __init__(
        self,
        scenario: Scenario,
        run_id: str,
        path: Path | None,
        serve: tuple[str, int] | None = None,
        reported: Reported | None = None,
    ) -> None:
        reported = reported if reported is not None else Reported.by(plan_of(scenario))
        sinks: list[Sink] = []
        self.live_url: str | None = None  # where `rerun` or `meanflock view` finds the live recording
        if serve is not None:
            host, port = listening_address(*serve)
            self.live_url = f"rerun+http://{f'[{host}]' if ':' in host else host}:{port}/proxy"
            sinks.append(rr.GrpcServerSink(bind_ip=host, port=port, server_memory_limit=_LATE_VIEWERS))
        if path is not None:
            durable.check_writable(path)
            sinks.append(rr.FileSink(path.absolute()))
        if not sinks:
            raise ValueError("a recorder needs a file, an address to serve on, or both")

        stream = new_stream(run_id)
        super().__init__(scenario, stream, reported, patience_s=FILE_WALL_S if serve is None else BATCH_WALL_S)
        self._path = path
        start(stream, sinks, blueprint.flight_blueprint(scenario, reported, serve is not None), path)
        if serve is not None:  # the server starts in a thread; a viewer that connects earlier would end at once
            await_listener(host, port)
        stream.send_recording_name(run_id)
        self.log_fixed()

    def __enter__(self) -> "Recorder":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with suppress(*[RunFailed] * (error is not None)):  # the first failure is the one that counts
            self.close()

    def close(self) -> None:
        """Writes the remaining rows and the file's footer, and stops serving. May be called again.

        Raises:
            RunFailed: the file is not complete; its disk is full or gone.
        """
        try:
            self.flush()
        except RuntimeError as error:
            raise _incomplete(self._path, str(error)) from error
        finally:
            stream, self._stream = self._stream, None
            if stream is not None:
                close(stream, self._path)


def new_stream(name: str) -> rr.RecordingStream:
    """A new recording of that name.

    Rerun keeps the threads and buffers of closed recordings, 3 MiB of a flight, until it is told to free them. That
    takes the program's own recording away, so it is set again.
    """
    of_program = rr.get_global_data_recording()
    with suppress(RuntimeError):  # the program's recording cannot be flushed
        flush_and_cleanup_orphaned_recordings()
    if of_program is not None:
        rr.set_global_data_recording(of_program)
    return rr.RecordingStream(APPLICATION, recording_id=name)


def start(stream: rr.RecordingStream, sinks: Sequence[Sink], shown: rrb.Blueprint, path: Path | None) -> None:
    """Sends a recording to its sinks, one of them perhaps the file `path`, beginning with how it is shown.

    Raises:
        RunFailed: the disk is full.
    """
    sent = _FreedBlueprint(shown)
    try:
        _patiently(lambda: stream.set_sinks(*sinks, default_blueprint=sent), path, "begun")
        sent.free()
    except RuntimeError as error:
        raise _incomplete(path, str(error)) from error


class _FreedBlueprint(rrb.Blueprint):
    """A blueprint that frees what Rerun makes of it: a recording in memory, which refers to itself until it is
    disconnected.
    """

    def __init__(self, shown: rrb.Blueprint) -> None:
        self._shown = shown
        self._streams: list[rr.RecordingStream] = []

    def _log_to_stream(self, stream: rr.RecordingStream) -> None:
        self._streams.append(stream)
        self._shown._log_to_stream(stream)

    def free(self) -> None:
        """Free the recordings that were made of it."""
        for stream in self._streams:
            stream.disconnect()
        self._streams.clear()


def close(stream: rr.RecordingStream, path: Path | None) -> None:
    """Writes the remaining rows of a recording, and its footer.

    Raises:
        RunFailed: the file is not complete; its disk is full or gone.
    """
    flush = stream.flush
    try:
        durable.settle(lambda seconds: flush(timeout_sec=seconds), path)
    except RuntimeError as error:
        raise _incomplete(path, str(error)) from error
    finally:
        _patiently(stream.disconnect, path, "closed")


def _patiently(call: Callable[[], None], path: Path | None, done: str) -> None:
    """Call Rerun in a thread, with a timeout: after a full disk it waits for ever for a dead thread of its own."""
    raised: list[Exception] = []

    def attempt() -> None:
        try:
            call()
        except Exception as error:
            raised.append(error)

    calling = Thread(target=attempt, daemon=True)
    calling.start()
    calling.join(CLOSE_WALL_S)
    if calling.is_alive():
        rr.unregister_shutdown()  # Rerun would also wait at the end of the process
        raise _incomplete(path, f"not {done} within {CLOSE_WALL_S:.0f} s")
    for error in raised:
        raise error


def _incomplete(path: Path | None, reason: str) -> RunFailed:
    if path is not None and not path.exists():
        return RunFailed(f"{path}: deleted or renamed during the flight: {reason}")
    return RunFailed(f"{path}: incomplete: {reason}; is the disk full?")
