"""Real leaderboards, in small: what is flown, kept and refused, and what a failure costs."""

import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from meanflock.studies import study
from meanflock.studies.leaderboard import board, missions, rows
from meanflock.studies.leaderboard.contest import Contest
from meanflock.studies.leaderboard.measures import BY_KEY
from meanflock.studies.store import Store
from meanflock.swarm.errors import EXIT_BAD_INPUT, EXIT_DONE, EXIT_RUN_FAILED
from tests.studies.leaderboard.courses import QUICK
from tests.studies.studies import interrupted

pytestmark = pytest.mark.usefixtures("undrawn")

ROOT = Path(__file__).parents[3]
SPRING = str(ROOT / "examples" / "spring.py")


def test_two_missions_by_two_rows_by_two_seeds(run, tmp_path, small) -> None:
    code, out, err = run("leaderboard", "--missions", *small, "--controllers", "cruise", "mfg", *QUICK)
    assert (code, err) == (EXIT_DONE, "")
    assert {"out/leaderboard.json", "out/leaderboard.md", "out/leaderboard.html"} <= set(out.splitlines())
    assert max(map(len, out.splitlines())) <= 80
    found = board.read(tmp_path / "out/leaderboard.json")
    assert found.seeds == [1, 2]
    assert [course.name for course in found.courses] == small
    for course in found.courses:
        assert [row.name for row in course.standings] == ["cruise", "mfg"]
        assert (course.uavs, course.duration_s, course.absent) == (3, 4.0, {})
        for row in course.standings:
            for key, cell in row.cells.items():
                _is_of_its_flights(key, cell, row.column(key))
            assert "obstacle_hits" not in row.cells
            assert "regret_J" not in row.cells  # nobody flies the way in four seconds
    flown = [run.scalars for run in Store(tmp_path / "out").finished().values()]
    assert len(flown) == 8
    mean = np.mean([one["energy_mean_J"] for one in flown if one["method"] == "cruise"])
    there = [course.standings[0].cells["energy_J"].mean for course in found.courses]
    assert np.mean(there) == pytest.approx(mean)


def _is_of_its_flights(key: str, cell: board.Cell, values: np.ndarray) -> None:
    """Means and intervals by their formulas; of two flights t is 12.706."""
    assert cell.n == len(values) == 2
    assert cell.mean == pytest.approx(values.mean(), rel=1e-5)
    assert cell.low is not None
    assert cell.high is not None
    if key == "free":
        free = int(values.sum())
        low = stats.beta.ppf(0.025, free, 3 - free) if free else 0.0
        high = stats.beta.ppf(0.975, free + 1, 2 - free) if free < 2 else 1.0
        assert (cell.low, cell.high) == pytest.approx((low, high))
    else:
        half = 12.7062 * values.std(ddof=1) / np.sqrt(2)
        assert cell.high - cell.mean == pytest.approx(half, rel=1e-3, abs=1e-5)
    assert cell.least == (pytest.approx(values.min(), rel=1e-5) if BY_KEY[key].least else None)


def test_what_is_finished_is_never_flown_twice(run, tmp_path, small, monkeypatch) -> None:
    flags = ("leaderboard", "--missions", *small, "--controllers", "cruise", "mfg", *QUICK)
    assert run(*flags)[0] == EXIT_DONE
    first = (tmp_path / "out/leaderboard.json").read_bytes()
    tried: list[Any] = []
    fly = study._fly
    monkeypatch.setattr(study, "_fly", lambda one, **how: tried.append(one) or fly(one, **how))
    assert run(*flags)[0] == EXIT_DONE
    assert tried == []
    assert (tmp_path / "out/leaderboard.json").read_bytes() == first
    more = ("leaderboard", "--missions", "near.toml", "--controllers", "cruise", "lqr", *QUICK)
    assert run(*more)[0] == EXIT_DONE
    assert [one.method for one in tried] == ["lqr", "lqr"]


def test_a_controller_of_the_readers_is_one_more_row_that_stands_out(run, tmp_path, small) -> None:
    flags = ("--plugin", SPRING, "--controllers", "spring", "cruise", "--missions", "near.toml")
    assert run("leaderboard", *flags, *QUICK)[0] == EXIT_DONE
    (course,) = board.read(tmp_path / "out/leaderboard.json").courses
    assert [(row.name, row.yours) for row in course.standings] == [("spring", True), ("cruise", False)]
    assert course.standings[0].kbit_by_kind["state"] > 0
    assert "<tr class=yours><td>spring</td>" in (tmp_path / "out/leaderboard.html").read_text()


BAD = """
import meanflock as mf

class Stumbles(mf.Controller):
    name = "stumbles"
    def step(self, memory, tick, own, received):
        if tick == 5:
            raise ValueError("no more ideas")
        return mf.Step(memory, -0.1 * own[:, :2])

class NeverBegins(mf.Controller):
    name = "never-begins"
    def init(self, uavs, plan):
        raise ValueError("not today")
    def step(self, memory, tick, own, received):
        return mf.Step(memory, 0 * own[:, :2])

class NoSuch(mf.Controller):
    name = "no-such"
    broadcast_numbers = -1
    def step(self, memory, tick, own, received):
        return mf.Step(memory, 0 * own[:, :2])
"""


def test_a_flight_that_fails_is_a_row_with_the_reason_and_not_the_end(run, tmp_path, small) -> None:
    (tmp_path / "bad.py").write_text(BAD)
    names = ("stumbles", "never-begins", "no-such", "cruise")
    flags = ("--plugin", "bad.py", "--controllers", *names, "--missions", "near.toml")
    code, out, _ = run("leaderboard", *flags, *QUICK)
    assert code == EXIT_DONE
    (course,) = board.read(tmp_path / "out/leaderboard.json").courses
    stumbles, never, cruise = course.standings
    assert (stumbles.lost, stumbles.failed) == (6, 0)
    assert "no more ideas" in stumbles.why
    assert stumbles.cells["time_s"].mean == 4.0
    assert "regret_J" not in stumbles.cells
    assert (never.failed, never.cells) == (2, {})
    assert "not today" in never.why
    assert "broadcast_numbers" in course.absent["no-such"]
    assert cruise.failed == 0
    for text in (out, (tmp_path / "out/leaderboard.md").read_text()):
        for said in ("no more ideas", "not today", "broadcast_numbers"):
            assert said in text


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        (("--missions", "mars"), "--missions mars: no such mission; there are paper"),
        (("--controllers", "magic"), "--controllers magic: no such row or controller; rows are"),
        (("--controllers", "cruise", "--missions"), "--missions: name one or more, or all"),
        (("--seeds", "0"), "--seeds"),
        (("--backend", "ray"), "ray"),
        (("--scheduler", "tcp://127.0.0.1:1"), "--backend dask"),
        (("--plugin", "nobody.py"), "nobody.py: No such file"),
        (("--out", "file/out"), "--out file/out"),
    ],
)
def test_bad_input_is_one_line_and_nothing_is_written(run, tmp_path, flags, says) -> None:
    (tmp_path / "file").write_text("")
    code, out, err = run("leaderboard", "--quiet", *flags)
    assert (code, out) == (EXIT_BAD_INPUT, "")
    assert err.startswith("error: ")
    assert err.strip().count("\n") == 0
    assert says in err
    assert os.listdir(tmp_path) == ["file"]


def test_words_between_commas_and_words_one_after_the_other_are_the_same(run, tmp_path, small) -> None:
    assert run("leaderboard", "--missions=near.toml", "--controllers", "cruise,mfg", *QUICK)[0] == EXIT_DONE
    (course,) = board.read(tmp_path / "out/leaderboard.json").courses
    assert [row.name for row in course.standings] == ["cruise", "mfg"]


@pytest.mark.processes
def test_ctrl_c_keeps_what_is_finished_and_a_repeat_flies_the_rest(run, tmp_path: Path) -> None:
    (tmp_path / "long.toml").write_text('uavs = 16\nduration = 30.0\nstop = "duration"\n')
    command = [sys.executable, "-c", "from meanflock.groundstation.cli.command import main; main()", "leaderboard"]
    command += ["--missions", "long.toml", "--controllers", "hjb", "mfg", "--seeds", "6", "--jobs", "2"]
    command += ["--quiet", "--out", "out"]
    code, printed, said = interrupted(command, tmp_path / "out", cwd=tmp_path)
    assert (code, printed) == (EXIT_RUN_FAILED, b"")
    assert b"error: interrupted; " in said
    assert b"Traceback" not in said
    kept = {path: path.stat().st_mtime_ns for path in tmp_path.glob("out/data/jobs/*.job")}
    assert not (tmp_path / "out/leaderboard.json").exists()
    assert run(*command[3:], "--jobs", "1")[0] == EXIT_DONE
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    (course,) = board.read(tmp_path / "out/leaderboard.json").courses
    assert [row.cells["time_s"].n for row in course.standings] == [6, 6]


@pytest.mark.processes
@pytest.mark.usefixtures("environment")
def test_on_dask_the_board_is_the_same_to_the_last_digit(run, tmp_path, small) -> None:
    distributed = pytest.importorskip("distributed", reason="dask is not installed")
    flags = ("leaderboard", "--missions", "near.toml", "--controllers", "cruise", "mfgfl-h")
    flags += ("--seeds", "2", "--first-seed", "1", "--quiet")
    assert run(*flags, "--jobs", "1", "--out", "here")[0] == EXIT_DONE
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, host="127.0.0.1"
    ) as cluster:
        there = ("--backend", "dask", "--scheduler", cluster.scheduler_address, "--out", "there")
        assert run(*flags, *there)[0] == EXIT_DONE
    here, there = ((tmp_path / folder / "leaderboard.json").read_bytes() for folder in ("here", "there"))
    assert here == there


def test_every_shipped_row_flies_its_missions() -> None:
    """Each resolves to a scenario; nothing is flown."""
    known = {mission.name for mission in missions.shipped()}
    contest = Contest(missions.shipped(), rows.shipped(), 1, 1)
    for row in rows.shipped():
        assert set(row.missions) <= known
    for mission, left in contest.absent.items():
        assert all(why.startswith("flies ") for why in left.values()), (mission, left)
