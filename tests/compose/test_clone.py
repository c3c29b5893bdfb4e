"""`docker compose up`, and nothing else, in a fresh clone."""

import json

from tests.compose.containers import FLIGHT_S, MARKS, Clone, docker
from tests.faults.by_hand import ticks_of

pytestmark = MARKS


def test_plain_compose_up_in_a_fresh_clone_flies_and_ends_well(clone: Clone) -> None:
    up = clone.up("seed=7 duration=20")
    said, _ = up.communicate(timeout=FLIGHT_S)
    assert up.returncode == 0, said
    assert json.loads((clone.folder / "summary.json").read_text())["ticks"] == 200
    assert clone.folder.stat().st_uid == 1000


def test_plain_compose_up_fails_where_the_ground_station_cannot_write(clone: Clone) -> None:
    clone.out.mkdir(mode=0o555)
    up = clone.up("seed=7 duration=20")
    said, _ = up.communicate(timeout=FLIGHT_S)
    assert up.returncode == 1, said
    assert "--out /runs: Permission denied" in said
    assert 'service "groundstation" didn\'t complete successfully: exit 2' in said


def test_plain_compose_up_fails_when_the_ground_station_dies_and_again_goes_on_in_its_folder(clone: Clone) -> None:
    for killed in (True, False):
        up = clone.up("seed=7 duration=100000 stop=duration")
        clone.flying(20_000)
        if killed:
            docker("kill", f"{clone.name}-groundstation-1")
        else:
            docker("stop", f"{clone.name}-worldsim-1")
        said, _ = up.communicate(timeout=FLIGHT_S)
        assert up.returncode == int(killed), said
        assert ("didn't complete successfully: exit 137" in said) == killed
    summary = json.loads((clone.folder / "summary.json").read_text())
    assert ticks_of(clone.folder) == list(range(summary["ticks"] + 1))
