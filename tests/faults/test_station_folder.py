"""In which folder a ground station records that is told to go on with the latest run, if that is of this flight."""

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


def test_it_goes_on_in_the_folder_of_its_flight(tmp_path: Path) -> None:
    killed(tmp_path, "compose-20260101-000000", 300)
    latest = killed(tmp_path, "compose-20260102-000000", 250)
    killed(tmp_path, "other-20260103-000000", 250)
    folder, so_far = _folder(LATEST, tmp_path, RUN, FLOWN, 260)
    assert folder == latest
    assert so_far is not None
    assert 100 < so_far.rows.num_rows <= 251


@pytest.mark.parametrize("tick", [0, 50])
def test_a_flight_that_has_not_come_so_far_is_another_one(tick: int, tmp_path: Path) -> None:
    killed(tmp_path, "compose-20260102-000000", 250)
    folder, so_far = _folder(LATEST, tmp_path, RUN, FLOWN, tick)
    assert not folder.exists()
    assert so_far is None


def test_what_is_finished_of_another_scenario_or_empty_is_left_alone(tmp_path: Path) -> None:
    finished = killed(tmp_path, "compose-20260101-000000", 250)
    (finished / SUMMARY).write_text("{}")
    assert _folder(LATEST, tmp_path, RUN, FLOWN, 260)[1] is None
    killed(tmp_path, "compose-20260102-000000", 250, seed=4)
    assert _folder(LATEST, tmp_path, RUN, FLOWN, 260)[1] is None
    (tmp_path / "compose-20260103-000000").mkdir()
    assert _folder(LATEST, tmp_path, RUN, FLOWN, 260)[1] is None
    with pytest.raises(BadInput, match="not a run of the scenario"):
        _folder(str(tmp_path / "compose-20260102-000000"), tmp_path, RUN, FLOWN, 260)


def test_two_that_begin_in_the_same_second_have_folders_of_their_own(tmp_path: Path) -> None:
    for expected in range(1, 4):
        folder, _ = _folder("", tmp_path, RUN, FLOWN, 0)
        folder.mkdir()
        assert len(list(tmp_path.iterdir())) == expected
