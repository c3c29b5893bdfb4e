"""Rows of groups: each has the figures of its own UAVs."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from meanflock.launch.engine import Engine
from meanflock.studies.leaderboard import board, missions, tables
from meanflock.studies.leaderboard.contest import Contest
from meanflock.studies.leaderboard.front import Fronts
from meanflock.studies.leaderboard.rows import BoardRow, chosen
from meanflock.studies.store import Store
from meanflock.swarm.errors import EXIT_DONE
from meanflock.swarm.scenario import Scenario
from tests.studies.conftest import BOARD

pytestmark = pytest.mark.usefixtures("undrawn")

FLIGHT = """
uavs = 6
duration = 30.0
[filter]
kind = "ecbf"
[start]
centre = [12.0, 9.0]
"""
OPEN = """
[[groups]]
name = "bold"
count = 4
[[groups]]
name = "wary"
count = 2
method = "orca"
vehicle = { acceleration_max = 3.0 }
"""


def mission_of(tmp_path: Path, groups: str) -> missions.BoardMission:
    path = tmp_path / "mixed.toml"
    path.write_text(FLIGHT + groups)
    return missions.BoardMission(str(path))


def course_of(tmp_path: Path, contest: Contest) -> board.Course:
    (course,) = contest.fly(1, lambda *_: None, Store(tmp_path / "out")).courses
    return course


def flown_alone(table: dict[str, Any], method: str) -> dict[str, Any]:
    return Engine(Scenario(**table, method=method, seed=1), "alone").complete()


def test_a_mission_with_groups_has_a_row_for_each_group_of_a_row(tmp_path: Path) -> None:
    mission = mission_of(tmp_path, OPEN)
    course = course_of(tmp_path, Contest([mission], chosen(["cruise", "mfg"]), 2, 1))
    assert [row.name for row in course.standings] == ["cruise/bold", "cruise/wary", "mfg/bold", "mfg/wary"]
    assert [row.controller for row in course.standings] == ["cruise", "orca", "mfg", "orca"]
    assert [row.uavs for row in course.standings] == [4, 2, 4, 2]
    table = mission.table()
    assert [group.get("vehicle") for group in table["groups"]] == [None, {"acceleration_max": 3.0}]
    assert table["vehicle"] == {"acceleration_max": 6.0}
    groups = flown_alone(table, "cruise")["groups"]
    for row, group in zip(course.standings, groups.values(), strict=False):
        assert row.values["energy_J"][0] == pytest.approx(group["energy_mean_J"], rel=1e-6)
        assert row.values["kbit"][0] == pytest.approx(group["bits_to_arrival"]["total"] / 1e3, rel=1e-6)
        assert row.values["arrived"][0] == group["arrived"] / group["uavs"]
        assert row.values["closest_m"][0] == pytest.approx(group["closest_approach_m"], rel=1e-6)
    assert course.front_s == []  # there is no line for all groups


def test_a_mission_whose_groups_all_name_a_controller_flies_once_with_the_keys_of_its_file(
    run: Any, tmp_path: Path
) -> None:
    mission_of(tmp_path, OPEN.replace("count = 4", 'count = 4\nmethod = "cruise"'))
    code, out, _ = run("leaderboard", "--missions", "mixed.toml", *BOARD)
    assert code == EXIT_DONE
    (course,) = board.read(tmp_path / "out/leaderboard.json").courses
    assert [row.name for row in course.standings] == ["mixed/bold", "mixed/wary"]
    assert {row.settings["filter.kind"] for row in course.standings} == {"ecbf"}
    assert course.absent == {}
    page = (tmp_path / "out/leaderboard.md").read_text()
    assert "Flights: 2, missions: 1, rows: 2" in page
    assert "| row | UAVs | n |" in page
    assert "| mixed/wary | 2 | 2 |" in page
    assert "UAVs" in out


def test_a_row_may_bring_the_groups(tmp_path: Path) -> None:
    groups = [{"name": "a", "count": 2, "method": "lqr"}, {"name": "b", "count": 4}]
    mixed = BoardRow("mixed", "cruise", settings={"groups": groups})
    course = course_of(tmp_path, Contest([mission_of(tmp_path, "")], [*chosen(["cruise"]), mixed], 2, 1))
    whole, first, second = course.standings
    assert [row.name for row in course.standings] == ["cruise", "mixed/a", "mixed/b"]
    assert [row.uavs for row in (whole, first, second)] == [None, 2, 4]
    shown = [[cell.text for cell in line] for line in tables.body(course)]
    assert [line[:3] for line in shown] == [["cruise", "6", "2"], ["mixed/a", "2", "2"], ["mixed/b", "4", "2"]]
    both = (2 * first.column("energy_J") + 4 * second.column("energy_J")) / 6
    assert np.isfinite(both).all()
    fits = BoardRow("large", "cruise", settings={"groups": [{"name": "a", "count": 9}]})
    assert (
        "`groups` have 9 UAVs"
        in Contest([mission_of(tmp_path, "")], [mixed, fits], 1, 1).absent[str(tmp_path / "mixed.toml")]["large"]
    )


def test_the_regret_of_a_group_is_that_of_its_vehicle_and_its_way() -> None:
    far = {"start": {"centre": [150.0, 90.0]}, "destination": {"radius": 2.0}}
    whole = Scenario(uavs=4, groups=[{"name": "a", "count": 1}, {"name": "b", "count": 3, **far}])
    alone = whole.of_group(whole.groups[1])
    fronts = Fronts(alone, slice(1, 4))
    same = Fronts(Scenario(uavs=3, **{"start": far["start"], "destination": far["destination"]}))
    times = np.array([60.0, 80.0])
    np.testing.assert_allclose(fronts.mean(times), same.mean(times))
    patrol = Scenario(uavs=4, method="orca", destination={"waypoints": [[0.0, 0.0], [9.0, 0.0]]})
    assert Fronts(patrol).each is None
