"""The folder of a ground station: that of the latest run if it is of this flight, else a new one."""

from pathlib import Path

import pytest

from meanflock.groundstation.__main__ import LATEST, _folder
from meanflock.groundstation.launch.engine import Engine
from meanflock.groundstation.results.run_folder import SUMMARY, RunFolder
from meanflock.swarm.errors import BadInput
from tests.faults.conftest import scenario

RUN = "compose"
FLOWN = scenario("duration=35")


def killed(out: Path, name: str, at: int, seed: int = 3) -> Path:
    """A folder whose recorder was killed at a tick."""
    flown = scenario("duration=35", f"seed={seed}")
    folder = RunFolder(out, name, flown)
    for tick in Engine(flown, "any", sinks=[folder]).fly():
        if tick == at:
            folder._background.wait()
            folder._events.close()
            break
    return out / name


def test_a_station_goes_on_in_the_folder_of_its_flight(tmp_path: Path) -> None:
    killed(tmp_path, "compose-20260101-000000", 300)
    latest = killed(tmp_path, "compose-20260102-000000", 250)
    killed(tmp_path, "other-20260103-000000", 250)
    folder, so_far = _folder(LATEST, tmp_path, RUN, FLOWN, 260)
    assert folder == latest
    assert so_far is not None
    assert 100 < so_far.rows.num_rows <= 251
    new, nothing = _folder(LATEST, tmp_path, RUN, FLOWN, 50)  # of a flight that has not come so far
    assert not new.exists()
    assert nothing is None


def test_a_folder_that_is_finished_or_of_another_scenario_or_empty_is_left_alone(tmp_path: Path) -> None:
    finished = killed(tmp_path, "compose-20260101-000000", 250)
    (finished / SUMMARY).write_text("{}")
    assert _folder(LATEST, tmp_path, RUN, FLOWN, 260)[1] is None
    killed(tmp_path, "compose-20260102-000000", 250, seed=4)
    assert _folder(LATEST, tmp_path, RUN, FLOWN, 260)[1] is None
    (tmp_path / "compose-20260103-000000").mkdir()
    assert _folder(LATEST, tmp_path, RUN, FLOWN, 260)[1] is None
    with pytest.raises(BadInput, match="not a run of the scenario"):
        _folder(str(tmp_path / "compose-20260102-000000"), tmp_path, RUN, FLOWN, 260)
