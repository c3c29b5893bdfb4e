"""Disk space of a run folder, estimated before take-off, and how coarsely a large swarm is recorded."""

import shutil
from pathlib import Path

from meanflock.swarm.scenario import Scenario

LARGE_SWARM = 200  # UAVs; a larger swarm is recorded more coarsely, or its recording costs more than its flight
LARGE_SWARM_STRIDE = 5  # ticks between recorded positions of a large swarm

# Bytes as measured, rather too many: of a UAV's row, and of a tick.
_SERIES_ROW, _SERIES_TICK = 70, 400  # timeseries.parquet; 4 more for each diagnostic
_RECORDED_ROW, _RECORDED_ROW_OF_MANY, _RECORDED_TICK = 45, 13, 2000  # recording.rrd
_FIXED = 2 * 10**6
_CHECKPOINT_ROW, _CHECKPOINT_PAIR = 500, 32  # beside the models; a pair of UAVs if they share states


def needed_mb(scenario: Scenario, record: bool) -> int:
    """Megabytes (10⁶ bytes) of the run folder if the flight takes as long as it may."""
    uavs, declared = scenario.uavs, scenario.declared
    tick = _SERIES_TICK + uavs * (_SERIES_ROW + 4 * len(declared.diagnostics))
    if record:
        tick += _RECORDED_TICK + uavs * (_RECORDED_ROW_OF_MANY if uavs > LARGE_SWARM else _RECORDED_ROW)
    checkpoint = uavs * (_CHECKPOINT_ROW + 8 * max(declared.weights, declared.parameters))
    checkpoint += _CHECKPOINT_PAIR * uavs * uavs if declared.pairwise else 0
    return (_FIXED + tick * scenario.max_ticks + checkpoint) // 10**6


def free_mb(folder: Path) -> int:
    """Free megabytes (10⁶ bytes) where a folder is, or would be made."""
    folder = folder.absolute()
    while not folder.exists():
        folder = folder.parent
    return shutil.disk_usage(folder).free // 10**6


def remedy(scenario: Scenario, record: bool, free: int) -> str:
    """Says how to make a run folder fit into so many free megabytes."""
    if record and needed_mb(scenario, False) <= free:
        return "fly without the recording: --no-record"
    return "a shorter flight: --duration S; or a disk with more room: --out DIR"


def coarseness(scenario: Scenario) -> str | None:
    """Says which data the recording of a large swarm leaves out; None if it has all."""
    if scenario.uavs <= LARGE_SWARM:
        return None
    return (
        f"recording of more than {LARGE_SWARM} UAVs: positions of every {LARGE_SWARM_STRIDE}th tick, straight "
        "pieces of trails, no graphs of rounds; timeseries.parquet has every tick"
    )
