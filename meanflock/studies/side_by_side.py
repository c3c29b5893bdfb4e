"""Recording of several flights side by side on one timeline."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from meanflock.federation.plan import plan_of
from meanflock.launch.engine import Engine
from meanflock.recording import blueprint, drawing, mission_map, rr, rrb
from meanflock.recording.blueprint import whole_flight
from meanflock.recording.drawing import scalars
from meanflock.recording.recorder import Writer, close, new_stream, start
from meanflock.results import quantities
from meanflock.results.series import BITS_SENT, COLUMN
from meanflock.swarm import durable
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import Telemetry

# Plots that all flights share: entity below the part of each, and its description.
ENERGY, BITS = "shared/energy", "shared/bits"
COLLISIONS, ARRIVED = "shared/collisions", "shared/arrived"
_TITLES = {
    ENERGY: f"{quantities.ENERGY.title()}, mean",
    BITS: f"{quantities.PAYLOAD.name}, Mbit",
    COLLISIONS: quantities.COLLISIONS.title(),
    ARRIVED: quantities.ARRIVED.title(),
}


def part_of(name: str) -> str:
    """Entity of the flight with a name."""
    return rr.escape_entity_path_part(name)


def record(flights: Mapping[str, Scenario], path: Path) -> dict[str, dict[str, Any]]:
    """Fly every scenario once in this process, into one recording; returns the summaries.

    Args:
        flights: at least one scenario, by its name in the recording. path: of the recording, which is replaced.

    Raises:
        BadInput: the file cannot be written, or a controller fails before it flies.
        RunFailed: a flight failed, or the disk is full.
    """
    durable.check_writable(path)
    flights = {name: plan_of(flown).given for name, flown in flights.items()}
    stream = new_stream(f"compare {' '.join(flights)}")
    writers = {
        name: _Beside(
            flown,
            stream,
            part=part_of(name),
            color=drawing.LINES[number % len(drawing.LINES)],
            name=name,
            maps=len(flights),
        )
        for number, (name, flown) in enumerate(flights.items())
    }
    start(stream, [rr.FileSink(path.absolute())], _blueprint(flights), path)
    try:
        stream.send_recording_name(f"compare: {', '.join(flights)}")
        summaries = {}
        for name, writer in writers.items():
            writer.log_fixed()
            summaries[name] = Engine(flights[name], f"compare-{name}", sinks=[writer]).complete()
            writer.flush()
    finally:
        close(stream, path)
    return summaries


class _Beside(Writer):
    """Sends a flight to its part of the recording, and a line to each shared plot."""

    def __init__(
        self, scenario: Scenario, stream: rr.RecordingStream, part: str, name: str, color: int, maps: int
    ) -> None:
        super().__init__(scenario, stream, part=part, maps=maps)
        self._name, self._color = name, color

    def log_fixed(self) -> None:
        """Logs what does not change in flight."""
        super().log_fixed()
        line = rr.SeriesLines(names=self._name, colors=np.array([self._color], dtype=np.uint32), widths=2.0)
        for entity in _TITLES:
            self._under.log(entity, line)

    def _send_blocks(self, blocks: list[Telemetry]) -> None:
        super()._send_blocks(blocks)
        ticks = np.concatenate([block.first_tick + np.arange(len(block.states)) for block in blocks])
        swarm = np.concatenate([block.swarm for block in blocks])
        for entity, values in (
            (ENERGY, np.concatenate([block.energy for block in blocks]).mean(axis=1)),
            (BITS, swarm[:, BITS_SENT].sum(axis=1) / 1e6),
            (COLLISIONS, swarm[:, COLUMN["collisions"]]),
            (ARRIVED, swarm[:, COLUMN["arrived"]]),
        ):
            self._send(scalars(entity, ticks, values))


def _blueprint(flights: Mapping[str, Scenario]) -> rrb.Blueprint:
    """A map for every flight, and below them the plots they share."""
    _, columns = mission_map.shape(len(flights))
    maps = [
        blueprint.flight_view(flown, name, f"{name} in space", part_of(name), len(flights))
        for name, flown in flights.items()
    ]
    plots = [
        rrb.TimeSeriesView(
            origin="/",
            contents=[f"/{part_of(name)}/{entity}" for name in flights],
            name=title,
            axis_x=whole_flight(),
            plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop),
        )
        for entity, title in _TITLES.items()
    ]
    views = rrb.Vertical(rrb.Grid(*maps, grid_columns=columns), rrb.Horizontal(*plots), row_shares=[3, 1.2])
    return blueprint.window(views, live=False)
