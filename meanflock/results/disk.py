"""Disk space of a run folder, estimated before take-off, and how coarsely a large swarm is recorded."""

import shutil
from pathlib import Path
from typing import NamedTuple

from meanflock.federation.plan import plan_of
from meanflock.swarm import state
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario

LARGE_SWARM = 200  # UAVs; a larger swarm is recorded more coarsely, or its recording costs more than its flight
LARGE_SWARM_STRIDE = 5  # ticks between recorded positions of a large swarm

# Bytes as measured, rather too many: of a UAV's row, and of a tick.
_SERIES_ROW, _SERIES_TICK = 70, 400  # timeseries.parquet; 4 more for each diagnostic
_RECORDED_ROW, _RECORDED_ROW_OF_MANY, _RECORDED_TICK = 45, 13, 2000  # recording.rrd
_SPACE_ROW, _SPACE_ROW_OF_MANY = 85, 20  # more of a recording in space
_FIXED = 2 * 10**6
_CHECKPOINT_ROW, _CHECKPOINT_PAIR = 500, 32  # beside the models; a pair of UAVs if they share states


class Remedies(NamedTuple):
    """Advice if a run folder does not fit: how to fly without a recording, and what else to do."""

    no_recording: str
    otherwise: str


OF_RUN = Remedies("--no-record", "a shorter flight: --duration S; or a disk with more room: --out DIR")
OF_RESUME = Remedies("--no-record", "make room on its disk")
OF_PYTHON = Remedies("record=False", "a shorter flight: duration=S; or a disk with more room: out=DIR")


def needed_mb(scenario: Scenario, record: bool, flown: int = 0) -> int:
    """Megabytes (10⁶ bytes) of the run folder if the flight takes as long as it may.

    `flown`: number of ticks whose series the folder has already.
    """
    uavs, plan = scenario.uavs, plan_of(scenario)
    declared = plan.declared
    series = (_SERIES_TICK + uavs * (_SERIES_ROW + 4 * len(plan.columns))) * (scenario.max_ticks - flown)
    large = uavs > LARGE_SWARM
    recorded = _RECORDED_ROW_OF_MANY if large else _RECORDED_ROW
    if scenario.space.dimensions == state.SPACE:
        recorded += _SPACE_ROW_OF_MANY if large else _SPACE_ROW
    recording = _RECORDED_TICK + uavs * recorded
    recording *= scenario.max_ticks if record else 0
    checkpoint = uavs * (_CHECKPOINT_ROW + 8 * max(declared.weights, declared.parameters))
    checkpoint += _CHECKPOINT_PAIR * uavs * uavs if declared.pairwise else 0
    return (_FIXED + series + recording + checkpoint) // 10**6


def free_mb(folder: Path) -> int:
    """Free megabytes (10⁶ bytes) where a folder is, or would be made."""
    folder = folder.absolute()
    while not folder.exists():
        folder = folder.parent
    return shutil.disk_usage(folder).free // 10**6


def room(scenario: Scenario, folder: Path, record: bool, remedies: Remedies, flown: int = 0) -> tuple[str, str | None]:
    """The space that a run folder needs and that is free; and advice, or None if it fits. Arguments: `needed_mb`."""
    needed, free = needed_mb(scenario, record, flown), free_mb(folder)
    ticks = scenario.max_ticks - flown
    found = f"up to {needed:,} MB for {scenario.uavs:,} UAVs over {ticks:,} ticks, {free:,} MB free"
    if needed <= free:
        return found, None
    if record and needed_mb(scenario, False, flown) <= free:
        return found, f"fly without the recording: {remedies.no_recording}"
    return found, remedies.otherwise


def check(scenario: Scenario, folder: Path, record: bool, remedies: Remedies, flown: int = 0) -> None:
    """Raise BadInput if a run folder does not fit on its disk; see `room`."""
    found, remedy = room(scenario, folder, record, remedies, flown)
    if remedy is not None:
        raise BadInput(f"disk: {found}; {remedy}")


def coarseness(scenario: Scenario) -> str | None:
    """Says which data the recording of a large swarm leaves out; None if it has all."""
    if scenario.uavs <= LARGE_SWARM:
        return None
    return (
        f"recording of more than {LARGE_SWARM} UAVs: positions of every {LARGE_SWARM_STRIDE}th tick, straight "
        "pieces of trails, no graphs of rounds; timeseries.parquet has every tick"
    )
