"""The flight as a Rerun recording: written to a file, served to viewers.

`Recorder` turns telemetry into columns and sends them in batches; `disturbances.py` does so with faults. `blueprint.py`
says how it looks, `legend.py` what it means, `screenshot.py` shows it, `recorded.py` reads it back. Only these and
`viewer.py` import rerun. Of what was sent, memory holds no more than rerun's index of the file, which becomes its
footer: some 70 KB a batch, and all of a run that grows with its length here.
"""

import time
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray

from meanflock.groundstation import blueprint as look
from meanflock.groundstation import durable, legend, palette, panels
from meanflock.groundstation.disturbances import Disturbances
from meanflock.groundstation.lines import log_sizes, span
from meanflock.groundstation.recorded import line
from meanflock.groundstation.reported import PHI_G, Reported
from meanflock.groundstation.viewer import await_listener, listening_address, open_viewer, repair, verify
from meanflock.swarm import state
from meanflock.swarm.errors import RunFailed
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import SWARM_COLUMNS, Event, FrameKind, Status, Telemetry

__all__ = ["Recorder", "open_viewer", "repair", "verify"]

APPLICATION = "meanflock"
BATCH_TICKS = 500  # rows sent at once; a few at a time, a recording is mostly headers, and its cost mostly calls:
_BATCH_STATES, _BATCH_TICKS_AT_MOST = 50_000, 2000  # more of a small swarm
BATCH_WALL_S = 0.5  # ... but a live viewer waits no longer than this
FILE_WALL_S = 2.0  # ... and who is killed leaves no more than this to be replayed
TRAIL_STEP_S = 0.5  # a trail is made of pieces this long
LARGE_SWARM_STRIDE = 5  # a large swarm's positions are recorded every this many ticks
LINKS_PER_TICK = 2000  # of a tick's links, as many are drawn; all are counted
STAR_M = 1.4  # radius of a collision's star

_LEVELS = {"dropped": "WARN", "slow": "WARN", "collision": "ERROR", "lost": "ERROR", "diverged": "ERROR"}
_LEVEL_COLORS = {"INFO": palette.WHITE, "WARN": palette.ORANGE, "ERROR": palette.RED}
_COLUMN = {name: index for index, name in enumerate(SWARM_COLUMNS)}
_SCALARS = rr.Scalars.descriptor_scalars()
_POINTS, _COLORS = rr.Points2D.descriptor_positions(), rr.Points2D.descriptor_colors()
_VECTORS, _ORIGINS = rr.Arrows2D.descriptor_vectors(), rr.Arrows2D.descriptor_origins()
_STRIPS, _STRIP_COLORS = rr.LineStrips2D.descriptor_strips(), rr.LineStrips2D.descriptor_colors()
_NODE_COLORS, _EDGES = rr.GraphNodes.descriptor_colors(), rr.GraphEdges.descriptor_edges()
_TEXT, _LEVEL, _TEXT_COLOR = (
    rr.TextLog.descriptor_text(),
    rr.TextLog.descriptor_level(),
    rr.TextLog.descriptor_color(),
)
_TRANSLATION = rr.Transform3D.descriptor_translation()

Ticks = NDArray[np.int64]
Floats = NDArray[np.float32]


class Recorder:
    """Writes a run's telemetry to a file, to live viewers, or both.

    Args:
        scenario: what is flown.
        run_id: name of the recording.
        path: the `.rrd` file to write; an existing one is replaced. None: no file.
        serve: address and port on which viewers find the recording, also when they come late; port 0 takes
            a free one. None: not served.
        memory_limit: what the server keeps for late viewers; beyond it, it forgets the oldest first.
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
        memory_limit: str = "256MB",
        reported: Reported | None = None,
    ) -> None:
        self._reported = reported if reported is not None else Reported.by(scenario.declared)
        sinks: list[rr.FileSink | rr.GrpcServerSink] = []
        self.live_url: str | None = None  # where `rerun` or `meanflock view` finds the live recording
        if serve is not None:
            host, port = listening_address(*serve)
            self.live_url = f"rerun+http://{f'[{host}]' if ':' in host else host}:{port}/proxy"
            sinks.append(rr.GrpcServerSink(bind_ip=host, port=port, server_memory_limit=memory_limit))
        if path is not None:
            durable.check_writable(path)
            sinks.append(rr.FileSink(path))
        if not sinks:
            raise ValueError("a recorder needs a file, an address to serve on, or both")

        self._scenario, self._path = scenario, path
        self._large = scenario.uavs > look.LARGE_SWARM
        self._trail_ticks = max(1, round(TRAIL_STEP_S / scenario.dt))
        self._pending: list[Telemetry] = []
        self._pending_ticks = 0
        self._batch_ticks = min(_BATCH_TICKS_AT_MOST, max(BATCH_TICKS, _BATCH_STATES // scenario.uavs))
        self._sent_at = time.monotonic()
        self._patience_s = FILE_WALL_S if serve is None else BATCH_WALL_S
        self._lanes: NDArray[np.uint8] = np.full(scenario.uavs, 255, dtype=np.uint8)  # none known yet
        self._round = np.zeros((0, 5), dtype=np.int32)  # links of the last one
        self._trail_start: Floats = np.empty((0, scenario.uavs, 2), dtype=np.float32)  # not yet in a piece

        self._disturbances = Disturbances(scenario)
        names, places = look.graph(scenario)
        nodes = rr.GraphNodes.columns(node_ids=names, labels=names, positions=places)
        self._names, self._nodes = pa.array(names), nodes.partition([scenario.uavs])  # of the graph of a round
        self._index_of: Ticks = np.empty(0, dtype=np.int64)
        self._index: tuple[rr.TimeColumn, ...] = ()
        self._stream: rr.RecordingStream | None = rr.RecordingStream(APPLICATION, recording_id=run_id)
        self._stream.set_sinks(*sinks, default_blueprint=look.blueprint(scenario, self._reported, serve is not None))
        if (
            serve is not None
        ):  # the server starts in a thread of its own; a viewer that came before it would end at once
            await_listener(host, port)
        self._stream.send_recording_name(run_id)
        look.log_static(self._stream, scenario, self._reported)
        legend.log(self._stream, scenario, self._reported)

    def __enter__(self) -> "Recorder":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with suppress(*[RunFailed] * (error is not None)):  # the first failure is the one that counts
            self.close()

    def write(self, block: Telemetry) -> None:
        """Records a block of T ≥ 1 ticks. Blocks come in the order of the flight; one may be missing."""
        if self._stream is None:
            raise ValueError("the recording is closed")
        self._pending.append(block)
        self._pending_ticks += len(block.states)
        if self._pending_ticks >= self._batch_ticks or time.monotonic() - self._sent_at >= self._patience_s:
            self._send_blocks(self._taken())

    def flush(self) -> None:
        """Sends what `write` still holds back."""
        if self._stream is not None and self._pending:
            self._send_blocks(self._taken())

    def _taken(self) -> list[Telemetry]:
        """What was held back, and is not any more."""
        blocks, self._pending, self._pending_ticks = self._pending, [], 0
        self._sent_at = time.monotonic()
        return blocks

    def _send_blocks(self, blocks: list[Telemetry]) -> None:
        ticks = np.concatenate([block.first_tick + np.arange(len(block.states)) for block in blocks])
        states = np.concatenate([block.states for block in blocks])
        diagnostics = np.concatenate([block.diagnostics for block in blocks])
        swarm = np.concatenate([block.swarm for block in blocks])
        events = [event for block in blocks for event in block.events]
        positions = states[..., state.POSITION].astype(np.float32)

        status = np.concatenate([block.status for block in blocks])

        if self._reported.has_phi_g:
            colors = palette.phi_g_colors(diagnostics[..., self._reported.diagnostics.index(PHI_G)])
        else:
            colors = palette.speed_colors(state.speed(states))
        colors[status == Status.LOST] = palette.GREY
        self._send_map(ticks, positions, states, colors)
        self._send_links(ticks, positions, np.concatenate([block.links for block in blocks]))
        self._send_reports(blocks)
        self._send_events(ticks, positions, swarm, events)
        if not self._large:
            self._send_lanes(ticks, self._disturbances.lanes(ticks, status))
        self._send_plots(ticks, states, diagnostics, swarm, np.concatenate([block.energy for block in blocks]))

    def close(self) -> None:
        """Writes what is left and the file's footer, and stops serving. May be called again.

        Raises:
            RunFailed: the file is not complete; its disk is full or gone.
        """
        try:
            self.flush()
            if self._stream is not None:
                flush = self._stream.flush
                durable.settle(lambda seconds: flush(timeout_sec=seconds), self._path)
        except RuntimeError as error:
            raise RunFailed(f"{self._path}: incomplete: {error}; is the disk full?") from error
        finally:
            stream, self._stream = self._stream, None
            if stream is not None:
                stream.disconnect()

    def _send(self, entity: str, ticks: Ticks, *columns: Any) -> None:
        """Sends component columns with one row a tick of `ticks`, (R,)."""
        if ticks is not self._index_of:  # most columns of a batch have those of all its ticks
            duration = rr.TimeColumn(look.TIMELINE, duration=ticks * self._scenario.dt)
            self._index_of, self._index = ticks, (duration, rr.TimeColumn(look.TICKS, sequence=ticks))
        flat = [column for group in columns for column in group]
        rr.send_columns(entity, self._index, flat, recording=self._stream)

    def _send_scalars(self, plot: str, ticks: Ticks, values: NDArray[Any]) -> None:
        """Sends the lines of a plot, `values` being (R,) or (R, lines)."""
        if len(ticks):
            scalars = rr.components.ScalarBatch(pa.array(values.reshape(-1).astype(np.float64, copy=False)))
            self._send(plot, ticks, _cut(len(ticks), (_SCALARS, scalars)))

    def _send_map(self, ticks: Ticks, positions: Floats, states: state.States, colors: NDArray[np.uint32]) -> None:
        """UAVs, velocities, faults and the leader's frame at every tick, and the pieces of trail now complete."""
        kept = (ticks % LARGE_SWARM_STRIDE == 0).nonzero()[0] if self._large else slice(None)
        if len(rows := ticks[kept]):
            rows = ticks if len(rows) == len(ticks) else rows
            points = positions[kept]
            arrows = (states[kept][..., state.VELOCITY] * look.ARROW_S).astype(np.float32)
            places = rr.components.Position2DBatch(points.reshape(-1, 2))
            costs = rr.components.ColorBatch(colors[kept].reshape(-1))
            vectors = rr.components.Vector2DBatch(arrows.reshape(-1, 2))
            self._send(look.UAVS, rows, _cut(len(rows), (_POINTS, places), (_COLORS, costs)))
            self._send(look.VELOCITY, rows, _cut(len(rows), (_VECTORS, vectors), (_ORIGINS, places)))
            leader = points[:, self._scenario.federation.leader]
            frame = np.concatenate([leader, np.zeros_like(leader[:, :1])], axis=-1)
            self._send(look.LEADER, rows, _cut(len(rows), (_TRANSLATION, rr.components.Translation3DBatch(frame))))
            for entity, at, columns in self._disturbances.rows(rows, states[kept]):
                self._send(entity, at, columns)

        path = np.concatenate([self._trail_start, positions])  # (P, N, 2)
        begun = len(self._trail_start)
        pieces = (len(path) - 1) // self._trail_ticks
        ends = np.arange(1, pieces + 1) * self._trail_ticks
        self._trail_start = path[pieces * self._trail_ticks :].copy()
        if pieces:
            steps = np.arange(self._trail_ticks + 1)
            if self._large:
                steps = steps[[0, -1]]
            strips = path[ends[:, None] - self._trail_ticks + steps].swapaxes(1, 2)  # (pieces, N, points, 2)
            strips = strips.reshape(-1, *strips.shape[2:])
            lines = rr.components.LineStrip2DBatch(_strips(strips))
            shades = (colors[ends - begun].reshape(-1) & ~np.uint32(0xFF)) | np.uint32(0x80)  # the dots stand out
            parts = (_STRIPS, lines), (_STRIP_COLORS, rr.components.ColorBatch(shades))
            self._send(look.TRAILS, ticks[ends - begun], _cut(pieces, *parts))

    def _send_links(self, ticks: Ticks, positions: Floats, links: NDArray[np.int32]) -> None:
        """A line from source to target for every transmission, green where delivered, red where in outage."""
        if not len(links):
            return
        links = links[np.argsort(links[:, 0], kind="stable")]
        models = links[:, 3] != FrameKind.STATE
        for entity, chosen in ((look.MODEL_LINKS, links[models]), (look.STATE_LINKS, links[~models])):
            if not len(chosen):
                continue
            _, first, count = np.unique(chosen[:, 0], return_index=True, return_counts=True)
            chosen = chosen[np.arange(len(chosen)) - np.repeat(first, count) < LINKS_PER_TICK]
            at, count = np.unique(chosen[:, 0], return_counts=True)
            row = np.clip(np.searchsorted(ticks, chosen[:, 0]), 0, len(ticks) - 1)
            ends = np.stack([positions[row, chosen[:, 1]], positions[row, chosen[:, 2]]], axis=1)  # (K, 2, 2)
            colors = np.where(chosen[:, 4] < 0, palette.RED, palette.GREEN).astype(np.uint32)
            lines = rr.components.LineStrip2DBatch(_strips(ends))
            parts = (_STRIPS, lines), (_STRIP_COLORS, rr.components.ColorBatch(colors))
            columns = [rr.ComponentColumn(descriptor, batch, lengths=count) for descriptor, batch in parts]
            self._send(entity, at.astype(np.int64), columns)
        if self._large:
            return
        for kind in (FrameKind.UPLOAD, FrameKind.RELAY):
            of_kind = links[links[:, 3] == kind]
            if len(of_kind):
                last = of_kind[of_kind[:, 0] == of_kind[-1, 0]]
                self._round = last if kind == FrameKind.UPLOAD else np.concatenate([self._round, last])
                self._send_round(last[:1, 0].astype(np.int64))

    def _send_round(self, at: Ticks) -> None:
        """The last round as a graph: who was heard (green), who was not (red), who was not asked (grey)."""
        uavs, leader = self._scenario.uavs, self._scenario.federation.leader
        sent = self._round
        colors = np.full(uavs, palette.GREY, dtype=np.uint32)
        colors[sent[:, 1]] = np.where(sent[:, 4] < 0, palette.RED, palette.GREEN)
        colors[leader] = palette.WHITE
        heard = sent[(sent[:, 4] >= 0) & (sent[:, 1] != sent[:, 2])]
        kind = rr.components.GraphEdgeBatch._ARROW_DATATYPE
        ends = [self._names.take(pa.array(column)) for column in heard[:, 1:3].T]
        edges = rr.components.GraphEdgeBatch(pa.StructArray.from_arrays(ends, fields=list(kind)))
        parts = (_NODE_COLORS, rr.components.ColorBatch(colors)), (_EDGES, edges)
        self._send(look.ROUND, at, self._nodes, _cut(1, *parts))

    def _send_plots(
        self,
        ticks: Ticks,
        states: state.States,
        diagnostics: Floats,
        swarm: NDArray[np.float64],
        energy: Floats,
    ) -> None:
        """Scalars over time, a row a tick; `blueprint.LAST` is."""

        def columns(*names: str) -> NDArray[np.float64]:
            return swarm[:, [_COLUMN[name] for name in names]]

        bits = columns("uplink_bits", "relay_bits", "broadcast_bits", "state_bits") / 1e6
        self._send_scalars(panels.SPEED.entity, ticks, span(state.speed(states)))
        self._send_scalars(panels.BITS.entity, ticks, bits)
        self._send_scalars(panels.ALIGNMENT.entity, ticks, columns("phi_A"))
        self._send_scalars(panels.RISK.entity, ticks, columns("phi_C", "phi_C_distinct"))
        self._send_scalars(panels.FAILURES.entity, ticks, columns("outages", "collisions"))
        for number, name in enumerate(self._reported.diagnostics):
            plot, values = panels.diagnostic(name), diagnostics[..., number]
            if plot.log10:
                known, lines = log_sizes(values)
                self._send_scalars(plot.entity, ticks if known.all() else ticks[known], lines)
            else:  # at take-off nothing was reported yet
                flown = slice(int(ticks[0] == 0), None)
                self._send_scalars(plot.entity, ticks[flown], span(values[flown]))
        self._send_scalars(panels.LAST.entity, ticks, span(energy))

    def _send_reports(self, blocks: list[Telemetry]) -> None:
        """What the leader's UAV has learned and the spread of all models, where the world asked for them."""
        if not self._reported.weights:
            return
        ticks = np.concatenate([block.report_ticks for block in blocks]).astype(np.int64)
        reports = np.concatenate([block.reports for block in blocks])
        self._send_scalars(panels.WEIGHTS, ticks, reports[:, self._reported.drawn])
        self._send_scalars(panels.SPREAD.entity, ticks, np.concatenate([block.spread for block in blocks]))

    def _send_events(self, ticks: Ticks, positions: Floats, swarm: NDArray[np.float64], events: list[Event]) -> None:
        """Lines of the log; a collision is also a star on the map and a mark on the risk it was taken at."""
        if not events:
            return
        levels = [_LEVELS.get(event.kind, "INFO") for event in events]
        shades = [
            palette.COLLISION if event.kind == "collision" else _LEVEL_COLORS[level]
            for event, level in zip(events, levels, strict=True)
        ]
        log = (
            (_TEXT, rr.components.TextBatch([line(event) for event in events])),
            (_LEVEL, rr.components.TextLogLevelBatch(levels)),
            (_TEXT_COLOR, rr.components.ColorBatch(np.array(shades, dtype=np.uint32))),
        )
        self._send(look.EVENTS, np.array([event.tick for event in events], dtype=np.int64), _cut(len(events), *log))

        hits = [event for event in events if event.kind == "collision" and event.uavs]
        if not hits:
            return
        at = np.array([event.tick for event in hits], dtype=np.int64)
        rows = np.clip(np.searchsorted(ticks, at), 0, len(ticks) - 1)
        centres = np.stack(
            [positions[row, list(event.uavs)].mean(axis=0) for row, event in zip(rows, hits, strict=True)]
        )
        stars = (centres[:, None] + STAR_M * legend.STAR).astype(np.float32)  # (hits, 11, 2)
        self._send(look.COLLISIONS, at, _cut(len(at), (_STRIPS, rr.components.LineStrip2DBatch(_strips(stars)))))
        self._send_scalars(panels.HITS, at, swarm[rows, _COLUMN["phi_C"]])

    def _send_lanes(self, ticks: Ticks, lanes: NDArray[np.uint8]) -> None:
        """What all lanes say, at the ticks where one changes."""
        changed = (np.concatenate([self._lanes[None], lanes[:-1]]) != lanes).any(axis=1)
        self._lanes = lanes[-1].copy()
        if changed.any():
            texts = [look.lane(uav, look.Lane(int(now))) for row in lanes[changed] for uav, now in enumerate(row)]
            counts = np.full(int(changed.sum()), self._scenario.uavs)
            self._send(look.LANES, ticks[changed], rr.StateChange.columns(state=texts).partition(counts))


def _cut(rows: int, *parts: tuple[rr.ComponentDescriptor, rr.ComponentBatchLike]) -> list[rr.ComponentColumn]:
    """Columns of so many rows, each with an equal share of all values. Those of rerun's archetypes are cut one by one
    first, and then anew: that takes longer than to send them."""
    columns = []
    for descriptor, batch in parts:
        each = len(batch.as_arrow_array()) // rows  # 0 where there is nothing to show: a round nobody was heard in
        offsets = np.arange(rows + 1, dtype=np.int32) * np.int32(each)
        columns.append(rr.ComponentColumn(descriptor, batch, offsets=offsets))
    return columns


def _strips(points: Floats) -> pa.ListArray:
    """Lines of P points each, (K, P, 2), in the form rerun has them; from an array it makes them one by one."""
    kind = rr.components.LineStrip2DBatch._ARROW_DATATYPE
    count, each, _ = points.shape
    flat = pa.FixedSizeListArray.from_arrays(points.reshape(-1), type=kind.value_type)
    return pa.ListArray.from_arrays(np.arange(0, count * each + 1, each, dtype=np.int32), flat, type=kind)
