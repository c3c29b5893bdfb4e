"""Flights, means, failed flights and the tuned constants of leaderboards."""

import json
import os
from html import unescape
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest

from meanflock.cli import leaderboard as command
from meanflock.results import statistics
from meanflock.studies import study
from meanflock.studies.leaderboard import board, flights, missions, rows
from meanflock.studies.leaderboard.contest import DEFAULT_POLICY, Contest
from meanflock.studies.leaderboard.measures import BY_KEY
from meanflock.swarm import plugins
from meanflock.swarm.errors import EXIT_BAD_INPUT, EXIT_DONE, BadInput
from research import tuning
from research.tuning import Arm, Score
from tests.sources import ROOT
from tests.studies.conftest import BOARD

pytestmark = pytest.mark.usefixtures("undrawn")

LINES = str(ROOT / "tests" / "agent" / "learning" / "lines.py")
SPRING = str(ROOT / "examples" / "spring.py")


def test_a_board_has_the_means_of_its_flights_and_flies_each_once(run, tmp_path, small, monkeypatch) -> None:
    command = ("leaderboard", "--missions", *small, "--controllers", "cruise", "mfg", *BOARD)
    code, out, err = run(*command)
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
    first = (tmp_path / "out/leaderboard.json").read_bytes()
    tried: list[Any] = []
    fly = study._fly
    monkeypatch.setattr(study, "_fly", lambda one, **how: tried.append(one) or fly(one, **how))
    assert run(*command)[0] == EXIT_DONE
    assert (tried, (tmp_path / "out/leaderboard.json").read_bytes()) == ([], first)
    more = ("leaderboard", "--missions=near.toml", "--controllers", "cruise,lqr", *BOARD)  # commas are allowed too
    assert run(*more)[0] == EXIT_DONE
    assert [one.method for one in tried] == ["lqr", "lqr"]


def _is_of_its_flights(key: str, cell: board.BoardCell, values: np.ndarray) -> None:
    expected = statistics.share(values == 1.0) if key == "free" else statistics.mean(values)
    found = (cell.mean, cell.low, cell.high)
    assert found == pytest.approx((expected.value, expected.low, expected.high), rel=1e-3, abs=1e-5)
    assert cell.n == len(values) == 2
    assert cell.least == (pytest.approx(values.min(), rel=1e-5) if BY_KEY[key].least else None)


def test_rows_that_share_states_fly_once_under_each_policy_and_all_at_the_limit(run, tmp_path, small) -> None:
    flags = ("--missions", "near.toml", "--controllers", "orca", "cruise", "--policies", "event", "tick")
    code, out, _ = run("leaderboard", *flags, *BOARD)
    assert code == EXIT_DONE
    found = board.read(tmp_path / "out/leaderboard.json")
    (course,) = found.courses
    assert found.policies == ["event", "tick"]
    assert [row.name for row in course.standings] == ["orca/event", "orca/tick", "cruise"]
    events, ticks, silent = (row.cells["kbit"].mean for row in course.standings)
    assert silent < events < ticks
    assert course.acceleration_max_m_s2 == 6.0
    page = (tmp_path / "out/leaderboard.md").read_text()
    for text in (out, page, (tmp_path / "out/leaderboard.html").read_text()):
        words = " ".join(text.split())
        assert "Acceleration is limited to 6 m/s²." in words
        assert "by the policy in the row's name" in unescape(words)


def test_a_mission_keeps_its_own_limit_of_acceleration(tmp_path) -> None:
    path = tmp_path / "slow.toml"
    path.write_text("uavs = 2\n[vehicle]\nacceleration_max = 1.5\n[sharing]\npolicy = 'tick'\n")
    table = missions.BoardMission(str(path)).table()
    assert table["vehicle"] == {"acceleration_max": 1.5}
    assert "sharing" not in table


BAD = """
import meanflock as mf

class Stumbles(mf.Controller):
    name = "stumbles"
    def step(self, memory, tick, own, received):
        if tick == 5:
            raise ValueError("no more ideas")
        return mf.Step(memory, -0.1 * own[:, :2])

class NeverBegins(Stumbles):
    name = "never-begins"
    def init(self, uavs, plan):
        raise ValueError("not today")

class NoSuch(Stumbles):
    name = "no-such"
    broadcast_numbers = -1
"""


def test_the_readers_controllers_are_highlighted_and_a_failed_flight_has_its_reason(run, tmp_path, small) -> None:
    (tmp_path / "bad.py").write_text(BAD)
    names = ("stumbles", "never-begins", "no-such", "spring", "cruise")
    flags = ("--plugin", "bad.py", "--plugin", SPRING, "--controllers", *names, "--missions", "near.toml")
    code, out, _ = run("leaderboard", *flags, *BOARD)
    assert code == EXIT_DONE
    (course,) = board.read(tmp_path / "out/leaderboard.json").courses
    stumbles, never, spring, cruise = course.standings
    assert [row.yours for row in course.standings] == [True, True, True, False]
    assert spring.kbit_by_kind["state"] > 0
    assert "<tr class=yours><td>spring</td>" in (tmp_path / "out/leaderboard.html").read_text()
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


DIVERGES = """
import meanflock as mf

class Diverges(mf.Learner):
    name = "diverges"
    period_ticks = 10
    @classmethod
    def initial(cls, options, scenario):
        return {"a": 0.0}
    def fit(self, model, config):
        return mf.Trained({"a": float("nan")}, 1)
"""


def test_trainings_that_give_no_model_have_their_reason(run, tmp_path, small) -> None:
    (tmp_path / "diverges.py").write_text(DIVERGES)
    flags = ("--learner", "diverges.py", "--controllers", "cruise", "--missions", "near.toml")
    code, out, _ = run("leaderboard", *flags, *BOARD)
    assert code == EXIT_DONE
    (row,) = board.read(tmp_path / "out/leaderboard.json").courses[0].standings
    assert (row.lost, row.failed, "its trained model is not finite" in row.why) == (0, 0, True)
    for text in (out, (tmp_path / "out/leaderboard.md").read_text()):
        assert (
            " ".join(text.split()).count(
                f"cruise: rounds, trainings or random numbers went wrong; the first: {row.why}"
            )
            == 1
        )


def test_a_learner_trains_under_rows_without_a_model_and_the_others_are_left_out(run, tmp_path, small) -> None:
    flags = ("--missions", "near.toml", "--learner", LINES, *BOARD)
    code, out, _ = run("leaderboard", "--controllers", "orca", "mfg", "mfgfl-hf", "rls", *flags)
    assert code == EXIT_DONE
    (course,) = board.read(tmp_path / "out/leaderboard.json").courses
    assert [row.name for row in course.standings] == ["orca", "mfg"]
    for row in course.standings:
        assert row.settings["training.learner"] == "line"
        assert (row.failed, row.lost) == (0, 0)
        assert row.kbit_by_kind["uplink"] > 0
    assert list(course.absent) == ["mfgfl-hf", "rls"]
    line = "not flown: mfgfl-hf, rls (shares a model of its own, so learner 'line' cannot share another)"
    assert line in " ".join(out.split())
    code, _, err = run("leaderboard", "--controllers", "mfgfl-hf", *flags)
    assert (code, "nothing can be flown: shares a model of its own" in err) == (EXIT_BAD_INPUT, True)


def test_a_mission_that_no_row_can_fly_has_the_reason_and_no_conditions(run, tmp_path, small) -> None:
    (tmp_path / "battery.toml").write_text("uavs = 3\nduration = 4.0\n[energy]\nbattery_J = 200.0\n")
    code, out, _ = run("leaderboard", "--missions", "near.toml", "battery.toml", "--controllers", "plan", *BOARD)
    assert code == EXIT_DONE
    assert [len(course.standings) for course in board.read(tmp_path / "out/leaderboard.json").courses] == [1, 0]
    for text in (out, (tmp_path / "out/leaderboard.md").read_text(), (tmp_path / "out/leaderboard.html").read_text()):
        assert "3 UAVs." in text
        assert "0 UAVs." not in text
    assert "not flown: plan (scenario: `energy.battery_J` sends UAVs home" in " ".join(out.split())


def test_all_missions_are_flown_over_the_radio_of_another_scenario(run, tmp_path, small, monkeypatch) -> None:
    flown: list[Any] = []
    fly = study._fly
    monkeypatch.setattr(study, "_fly", lambda one, **how: flown.append(one) or fly(one, **how))
    flags = ("leaderboard", "--missions", *small, "--controllers", "cruise", "mfgfl-h", *BOARD)
    assert run(*flags, "--radio", "radio-sky")[0] == EXIT_DONE
    courses = board.read(tmp_path / "out/leaderboard.json").courses
    assert all(course.about.endswith("Radio of radio-sky.") for course in courses)
    assert [row.failed for course in courses for row in course.standings] == [0] * 2 * len(small)
    assert {(one.radio.model, one.radio.access) for one in flown} == {("link-budget", "tdma")}


@pytest.mark.processes
@patch.dict(os.environ)  # Distributed sets variables of this process, and leaves them
def test_a_dask_cluster_flies_the_same_board(run, tmp_path, small) -> None:
    pytest.importorskip("distributed", reason="dask is not installed")
    flags = ("leaderboard", "--missions", "near.toml", "--controllers", "cruise", "mfgfl-h", *BOARD[:-2])
    assert run(*flags, "--out", "here")[0] == EXIT_DONE
    assert run(*flags, "--out", "there", "--backend", "dask")[0] == EXIT_DONE
    here, remote = ((tmp_path / folder / "leaderboard.json").read_bytes() for folder in ("here", "there"))
    assert here == remote


def test_every_shipped_row_flies_its_missions() -> None:
    assert command._DEFAULT_POLICY == DEFAULT_POLICY
    known = {mission.name for mission in missions.shipped()}
    contest = Contest(missions.shipped(), rows.shipped(), 1, 1)
    for row in rows.shipped():
        assert set(row.missions) <= known
    for mission, left in contest.absent.items():
        reasons = ("flies windmap only", " flies in 2 dimensions, and `space.dimensions` is 3")
        assert all(any(each in reason for each in reasons) for reason in left.values()), (mission, left)


ARM = Arm("cruise", "cruise", "controller", "trip", ({"speed_m_s": 1.0}, {"speed_m_s": 2.0}, {"speed_m_s": 3.0}))


def test_every_arm_has_the_same_budget_and_valid_candidates(tmp_path, monkeypatch) -> None:
    found = tuning.arms()
    assert {len(arm.candidates) for arm in found} == {8}
    (mission, *_) = missions.shipped()
    for arm in found:
        for candidate, options in enumerate(arm.candidates):
            assert set(options) == set(arm.candidates[0])
            arm.scenario(candidate, mission, 1)
    text = tuning.ARMS.read_text(encoding="utf-8")
    (tmp_path / "tuning.toml").write_text(text.replace("    { right_bias = 0.0", "#   { right_bias = 0.0", 1))
    monkeypatch.setattr(tuning, "ARMS", tmp_path / "tuning.toml")
    with pytest.raises(BadInput, match=r"same number of candidates; they have orca 7, bvc 8"):
        tuning.arms()


def test_a_tuning_goes_on_where_it_was_and_its_record_names_what_flew(tmp_path, small, monkeypatch) -> None:
    monkeypatch.setattr(tuning.missions, "chosen", lambda names: [missions.BoardMission(str(tmp_path / small[0]))])
    monkeypatch.setattr(tuning, "FIRST", range(1, 2))
    monkeypatch.setattr(tuning, "REST", range(2, 4))
    out = tmp_path / "out"
    record = tuning.tuned([ARM], 1, out)["cruise"]
    assert record["code"] == tuning.version()
    assert [candidate["flights"] for candidate in record["candidates"]].count(3) == tuning.FINALISTS
    assert record["acceleration_max_m_s2"] == 6.0
    assert record["chosen"] in ARM.candidates
    monkeypatch.setattr(flights, "Engine", None)  # nothing is flown again
    assert tuning.tuned([ARM], 1, out)["cruise"] == record


def test_the_constants_are_those_of_the_record() -> None:
    shipped = {row.name: row for row in rows.shipped()}
    records = json.loads(tuning.RECORD.read_text(encoding="utf-8"))
    assert list(records) == [arm.name for arm in tuning.arms()]
    for name, record in records.items():
        kind = "controller" if name in plugins.names("controller") or name in shipped else "filter"
        finalists = [each for each in record["candidates"] if each["flights"] == 100]
        best = min(
            finalists, key=lambda each: tuning.order(record["objective"], Score(each["unsafe"], each["objective"], 100))
        )
        assert best["options"] == record["chosen"]
        plugin = plugins.load(kind, record["method"] if kind == "controller" else name)
        defaults = plugin.Options()
        settings = shipped[name].settings if name in shipped else {}
        for key, value in record["chosen"].items():
            assert settings.get(f"controller.{key}", getattr(defaults, key)) == value, (name, key)
