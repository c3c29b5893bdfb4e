"""A synthetic flight with known numbers, and readers of recordings."""

from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from rerun.chunk import RrdReader

from meanflock.recording import blueprint as look
from meanflock.recording import plots
from meanflock.recording import recorder as recording
from meanflock.recording.recorder import Recorder
from meanflock.results.series import Reported
from meanflock.swarm import state
from meanflock.swarm.events import Collided, FaultBegan, FlightEvent, Grounded, Lost
from meanflock.swarm.scenario import Scenario, Space
from meanflock.swarm.wire.messages import SWARM_COLUMNS, FrameKind, LinkColumn, Status, Telemetry

ROUND_TICKS = 100
DIAGNOSTICS = ("hjb_residual", "fpk_residual", "phi_G")  # of the paper's scenario, which is the default
WEIGHTS = 246
HJB = plots.diagnostic("hjb_residual")
COLLISIONS = ((120, (3, 4)), (121, (5, 6)), (333, (0, 24)))  # tick, pair


def flight(uavs: int = 25, ticks: int = 600, block: int = 20, axes: int = state.PLANE) -> list[Telemetry]:
    """A made-up flight from (150, 100) to the origin in 60 s, with rounds, collisions and a lost UAV.

    In space it comes down from 60 m, and UAV 2 hits the ground.
    """
    rng = np.random.default_rng(1)
    tick = np.arange(ticks)
    share = (tick / 600)[:, None, None]
    position = np.array([150.0, 100.0, 60.0])[:axes] * (1 - share) + rng.normal(size=(1, uavs, axes)) * 3
    velocity = np.broadcast_to([-2.5, -1.7, -1.0][:axes], position.shape) + 0.1 * rng.normal(size=position.shape)
    states = np.concatenate([position, velocity], axis=-1)
    diagnostics = np.abs(rng.normal(size=(ticks, uavs, 3))).astype(np.float32)
    diagnostics[0] = 0  # nobody has learned yet
    diagnostics[:, -1, :2] = 0  # nobody ever hears of the last one
    status = np.zeros((ticks, uavs), dtype=np.uint8)
    status[500:, 0] = Status.ARRIVED
    status[400:, min(7, uavs - 1)] = Status.LOST
    swarm = rng.random(size=(ticks, len(SWARM_COLUMNS)))
    return [
        Telemetry(
            run=1,
            block=number,
            first_tick=first,
            states=states[first : first + block],
            accelerations=np.zeros((len(tick[first : first + block]), uavs, axes), dtype=np.float32),
            diagnostics=diagnostics[first : first + block],
            status=status[first : first + block],
            energy=np.cumsum(np.ones((ticks, uavs), dtype=np.float32), axis=0)[first : first + block],
            swarm=swarm[first : first + block],
            links=_links(uavs, first, block),
            report_ticks=np.array([first], dtype=np.int32),
            reports=rng.normal(size=(1, WEIGHTS)).astype(np.float32),
            spread=np.array([1.0]),
            events=_events(uavs, first, block, axes),
            diagnostic_names=DIAGNOSTICS,
        )
        for number, first in enumerate(range(0, ticks, block))
    ]


def _links(uavs: int, first: int, block: int) -> np.ndarray:
    rows = [
        (tick, source, 0, FrameKind.UPLOAD, 4, source % 5 != 0, 0)
        for tick in range(first, first + block)
        if tick and tick % ROUND_TICKS == 0
        for source in range(1, uavs - 1)
    ]
    if first == 0:
        rows += [(0, source, (source + 1) % uavs, FrameKind.STATE, 1, 1, 0) for source in range(uavs)]
    return np.array(rows, dtype=np.int32).reshape(-1, len(LinkColumn))


def _events(uavs: int, first: int, block: int, axes: int) -> tuple[FlightEvent, ...]:
    events: list[FlightEvent] = [Collided(tick, *pair) for tick, pair in COLLISIONS if uavs > max(pair)]
    events += [Lost(400, (7,), "silent"), FaultBegan(100, (), 0, "a gust")]
    events += [Grounded(50, 2)] * (axes == state.SPACE)
    return tuple(event for event in events if first <= event.tick < first + block)


def record(path: Path, blocks: list[Telemetry], reported: Reported | None = None, **changes: Any) -> Scenario:
    """In batches of 500 ticks, so that a flight of 600 is of two."""
    axes = state.axes(blocks[0].states)
    scenario = Scenario(**{"uavs": blocks[0].states.shape[1], "space": Space(dimensions=axes), **changes})
    batches = patch.object(recording, "_BATCH_TICKS_AT_MOST", 500)
    with batches, Recorder(scenario, "test", path, reported=reported) as recorder:
        for block in blocks:
            recorder.write(block)
    return scenario


def column(path: Path, entity: str, name: str) -> tuple[np.ndarray, list[Any]]:
    """Ticks (R,) and a component's rows, in the order of the ticks."""
    rows: list[tuple[int, Any]] = []
    for chunk in RrdReader(path).stream().filter(content=f"/{entity}"):
        batch = chunk.to_record_batch()
        if look.TICKS in batch.schema.names and name in batch.schema.names:
            ticks, values = batch.column(look.TICKS).to_pylist(), batch.column(name).to_pylist()
            rows += zip(ticks, values, strict=True)
    rows.sort(key=lambda row: row[0])
    return np.array([tick for tick, _ in rows]), [value for _, value in rows]


def scalars(path: Path, plot: plots.Plot | str) -> tuple[np.ndarray, np.ndarray]:
    entity = plot if isinstance(plot, str) else plot.entity
    ticks, values = column(path, entity, "Scalars:scalars")
    return ticks, np.array(values)


def fixed(path: Path, entity: str, name: str) -> list[Any]:
    for chunk in RrdReader(path).stream().filter(content=f"/{entity}"):
        batch = chunk.to_record_batch()
        if look.TICKS not in batch.schema.names and name in batch.schema.names:
            return batch.column(name).to_pylist()[0]
    return []


def rows(path: Path, entity: str, name: str) -> dict[int, Any]:
    ticks, values = column(path, entity, name)
    return dict(zip(ticks.tolist(), values, strict=True))
