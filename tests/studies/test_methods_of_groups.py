"""The method of flights with groups: the controllers of all, and refused where it would change nothing."""

from pathlib import Path
from typing import Any

import pytest

import meanflock as mf
from meanflock.studies.swept import add_point, point_of
from meanflock.swarm.errors import EXIT_BAD_INPUT, EXIT_DONE, BadInput
from meanflock.swarm.scenario import Scenario
from tests.studies.conftest import BOARD, QUICK, flown, rows

pytestmark = pytest.mark.usefixtures("undrawn")

OPEN = [{"name": "a", "count": 2}, {"name": "b", "count": 2, "method": "orca"}]
NAMED = [OPEN[0] | {"method": "cruise"}, OPEN[1]]
TEXT = "uavs = 4\n[[groups]]\nname = 'a'\ncount = 2\n{}[[groups]]\nname = 'b'\ncount = 2\nmethod = 'orca'\n"


@pytest.fixture
def files(tmp_path: Path) -> None:
    (tmp_path / "open.toml").write_text(TEXT.format(""))
    (tmp_path / "named.toml").write_text(TEXT.format("method = 'cruise'\n"))


@pytest.mark.usefixtures("files")
def test_tables_of_a_study_name_the_controllers_of_all_groups(run: Any, tmp_path: Path) -> None:
    command = ("sweep", "wind.sigma=0.1,0.2", "--methods", "cruise", "lqr", "--scenario", "open.toml")
    code, out, _ = run(*command, "--seeds", "1", *QUICK)
    assert code == EXIT_DONE
    lines = [line.split() for line in out[out.index("means of each group of UAVs") :].splitlines()]
    assert [line[:4] for line in lines if line[2:3] in (["a"], ["b"])] == [
        [sigma, method, group, "0/2"]
        for sigma in ("0.1", "0.2")
        for method in ("cruise+orca", "lqr+orca")
        for group in ("a", "b")
    ]
    expected = [("cruise+orca", sigma) for sigma in (0.1, 0.2)] + [("lqr+orca", sigma) for sigma in (0.1, 0.2)]
    assert sorted((row["method"], row["wind.sigma"]) for row in flown(tmp_path / "out")) == expected
    assert sorted({row["method"] for row in rows(tmp_path / "out/sweep.csv")}) == ["cruise+orca", "lqr+orca"]
    compared = mf.compare(["cruise", "lqr"], scenario=Scenario(uavs=4, duration=3.0, groups=OPEN), seeds=1, jobs=1)
    assert [row["method"] for row in compared] == ["cruise+orca", "lqr+orca"]
    swept = mf.sweep("method", ["cruise", "lqr"], scenario=Scenario(uavs=4, duration=3.0, groups=OPEN), seeds=1, jobs=1)
    assert [row["method"] for row in swept] == ["cruise+orca", "lqr+orca"]


@pytest.mark.usefixtures("files")
def test_the_number_of_uavs_follows_the_counts_of_groups_that_are_set(run: Any, tmp_path: Path) -> None:
    command = ("sweep", "groups.a.count=1,3", "groups.b.count=2,4", "--scenario", "open.toml", "--seeds", "1")
    assert run(*command, *QUICK)[0] == EXIT_DONE
    flights = flown(tmp_path / "out")
    assert sorted((row["groups.a.count"], row["groups.b.count"], row["uavs"]) for row in flights) == [
        (a, b, a + b) for a in (1, 3) for b in (2, 4)
    ]
    scenario = Scenario(uavs=4, groups=OPEN)
    assert scenario.replace(**{"groups.a.count": 7}).uavs == 9
    refused: dict[str, dict[str, Any]] = {
        "`groups` have 9 UAVs in all, and `uavs` is 4; set `uavs` to 9": {"groups.a.count": 7, "uavs": 4},
        r"groups\.a\.count: expected a whole number >= 1, got -9": {"groups.a.count": -9},
        "none is called 'c'; there are a, b": {"groups.c.count": 7},
        "groups: expected a list, got 3": {"groups.a.count": 7, "groups": 3},
    }
    for text, keys in refused.items():
        with pytest.raises(mf.BadInput, match=text):
            scenario.replace(**keys)
    code, out, err = run("run", "open.toml", "--set", "groups.a.count=7", "--uavs", "4", "--in-process")
    assert (code, out) == (EXIT_BAD_INPUT, "")
    assert "set `uavs` to 9" in " ".join(err.split())


@pytest.mark.usefixtures("files")
@pytest.mark.parametrize(
    "command",
    [
        ("run", "named.toml", "--method", "hjb", "--in-process"),
        ("run", "named.toml", "--set", "method=hjb", "--in-process"),
        ("compare", "hjb", "--scenario", "named.toml"),
        ("sweep", "wind.sigma=0.1,0.2", "--methods", "hjb", "--scenario", "named.toml"),
        ("sweep", "method=hjb,cruise", "--scenario", "named.toml"),
    ],
    ids=" ".join,
)
def test_a_method_that_would_change_nothing_is_refused(run: Any, command: tuple[str, ...]) -> None:
    code, out, err = run(*command)
    assert (code, out) == (EXIT_BAD_INPUT, "")
    assert "`method` hjb has no effect" in " ".join(err.split())
    assert "groups.a.method=hjb" in err


@pytest.mark.usefixtures("files")
@pytest.mark.parametrize(
    ("command", "remedy"),
    [
        (("leaderboard", "--controllers", "cruise", *BOARD), "leave out --controllers"),
        (("frontier", "--uavs", "4", "--quiet"), "remove `method` from a group"),
    ],
)
def test_rows_are_refused_for_a_mission_that_flies_once(run: Any, command: tuple[str, ...], remedy: str) -> None:
    code, _, err = run(*command, "--missions", "named.toml")
    assert code == EXIT_BAD_INPUT
    assert remedy in " ".join(err.split())


def test_python_refuses_it_too() -> None:
    named = Scenario(uavs=4, duration=3.0, groups=NAMED)
    for call in (lambda: mf.fly(named, method="hjb"), lambda: mf.compare(["hjb", "mfg"], scenario=named)):
        with pytest.raises(BadInput, match="`method` hjb has no effect"):
            call()


def test_flights_of_one_name_are_not_mistaken_for_one() -> None:
    groups = [{"name": "a", "count": 1, "method": "orca"}, {"name": "b", "count": 1}]
    groups.append({"name": "c", "count": 1, "method": "bvc"})
    points: dict[tuple[Any, ...], Scenario] = {}
    first, again, other = (Scenario(uavs=3, method=method, groups=groups) for method in ("orca", "orca", "bvc"))
    for one in (first, again):
        add_point(points, point_of(("method",), (), one), one)
    assert list(points) == [("orca+bvc",)]
    with pytest.raises(BadInput, match=r"called orca\+bvc"):
        add_point(points, point_of(("method",), (), other), other)
