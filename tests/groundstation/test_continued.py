"""A recorder that is killed again and again loses nothing of what it had written before."""

from pathlib import Path

from rerun.chunk import RrdReader

from meanflock.groundstation.recording import blueprint as look
from meanflock.groundstation.recording.recorder import Recorder
from meanflock.groundstation.recording.replay import Continued, verify
from tests.faults.conftest import Lab, scenario


def ticks_in(recording: Path) -> set[int]:
    """The ticks of all rows that say where the UAVs are."""
    found: set[int] = set()
    for chunk in RrdReader(recording).stream().filter(content=f"/{look.UAVS}"):
        batch = chunk.to_record_batch()
        if look.TICKS in batch.schema.names:
            found.update(batch.column(look.TICKS).to_pylist())
    return found


def test_a_recorder_killed_twice_leaves_three_parts_that_become_one(tmp_path: Path) -> None:
    flown = scenario()
    lab = Lab(flown)
    lab.fly()
    path, blocks = tmp_path / "recording.rrd", lab.record.blocks
    for number in range(3):
        continued = Continued(path)
        continued.__enter__()
        recorder = Recorder(flown, "run", path)
        for block in blocks[2 * number : 2 * number + 2]:
            recorder.write(block)
        recorder.close()
        if number == 2:  # the ones before were killed before they came to this
            continued.__exit__()
    assert verify(path) is None
    assert [p.name for p in tmp_path.iterdir()] == ["recording.rrd"]
    flown_ticks = {block.first_tick + row for block in blocks[:6] for row in range(len(block.states))}
    assert ticks_in(path) == flown_ticks
