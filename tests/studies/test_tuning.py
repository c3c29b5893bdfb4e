"""The tuning of constants: the same budget for every arm, an order of results, and no mixture of codes."""

import json

import pytest

from meanflock.studies import tuning
from meanflock.studies.leaderboard import flights, missions
from meanflock.studies.tuning import Arm, Score
from meanflock.swarm.errors import BadInput

ARM = Arm("cruise", "cruise", "controller", "trip", ({"speed_m_s": 1.0}, {"speed_m_s": 2.0}, {"speed_m_s": 3.0}))
MISSION = """
uavs = 2
duration = 20.0
[start]
centre = [20.0, 12.0]
"""


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


def test_a_tuning_goes_on_where_it_was_and_its_record_names_what_flew(tmp_path, monkeypatch) -> None:
    path = tmp_path / "near.toml"
    path.write_text(MISSION)
    monkeypatch.setattr(tuning.missions, "chosen", lambda names: [missions.Mission(str(path))])
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
    from meanflock.studies.leaderboard import rows
    from meanflock.swarm import plugins

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
