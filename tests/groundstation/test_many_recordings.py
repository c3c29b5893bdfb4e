"""Many recordings in one process: nothing of a closed one stays, and the program's own recording does."""

import gc
from pathlib import Path

import psutil
import rerun as rr

import meanflock as mf
from meanflock.studies import side_by_side
from meanflock.swarm.scenario import load

FLOWN = {"method": "plan", "uavs": 2, "duration": 1.0}


def threads_after(flights: int, folder: Path) -> int:
    """Threads of this process after so many recorded flights; a recording of Rerun has several."""
    for _ in range(flights):
        mf.fly("paper", out=folder, record=True, **FLOWN)
        gc.collect()
    return psutil.Process().num_threads()


def test_threads_and_buffers_of_a_recording_are_freed(tmp_path: Path) -> None:
    first = threads_after(2, tmp_path)
    assert threads_after(4, tmp_path) <= first


def test_the_recording_of_the_program_stays_its_own(tmp_path: Path) -> None:
    own = rr.RecordingStream("program")
    rr.set_global_data_recording(own)
    try:
        mf.fly("paper", out=tmp_path, record=True, **FLOWN)
        side_by_side.record({"plan": load(None, **FLOWN)}, tmp_path / "beside.rrd")
        current = rr.get_global_data_recording()
        assert current is not None
        assert current.get_recording_id() == own.get_recording_id()
    finally:
        rr.set_global_data_recording(None)
