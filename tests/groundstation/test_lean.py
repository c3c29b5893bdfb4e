"""Flights where Rerun is not installed: without a recording, and otherwise the same."""

import json
import sys

import pytest

import meanflock as mf
from meanflock.groundstation import doctor
from meanflock.groundstation.cli.command import main

LINE = "no recording.rrd is written: rerun is not installed; pip install 'meanflock[ground]'\n"
FLIGHT = ["run", "--in-process", "--uavs", "2", "--duration", "5", "--json"]


@pytest.fixture
def _no_rerun(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)


def test_the_run_folder_is_the_same_but_for_the_recording(tmp_path, capsys, monkeypatch) -> None:
    assert main([*FLIGHT, "--out", str(tmp_path / "full")]) == 0
    full = json.loads(capsys.readouterr().out)
    monkeypatch.setitem(sys.modules, "rerun", None)
    assert main([*FLIGHT, "--out", str(tmp_path / "lean")]) == 0
    out, err = capsys.readouterr()
    lean = json.loads(out)
    assert err.count(LINE) == 1
    assert lean["trajectory_sha256"] == full["trajectory_sha256"]
    files = {kind: {path.name for path in (tmp_path / kind).glob("*/*")} for kind in ("full", "lean")}
    assert files["full"] - files["lean"] == {"recording.rrd"}
    assert not files["lean"] - files["full"]
    assert mf.open(tmp_path / "lean" / lean["run_id"]).recording is None


@pytest.mark.usefixtures("_no_rerun")
@pytest.mark.parametrize("flag", ["--quiet", "--no-record", "--log-format=json"])
def test_nothing_is_said_where_nobody_listens_or_no_recording_is_wanted(flag: str, tmp_path, capsys) -> None:
    assert main([*FLIGHT, flag, "--out", str(tmp_path)]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["arrived"] is not None
    assert "rerun" not in err


@pytest.mark.usefixtures("_no_rerun")
def test_a_recording_that_is_asked_for_is_refused_and_nothing_is_written(tmp_path) -> None:
    with pytest.raises(mf.BadInput, match=r"record=True needs it: pip install 'meanflock\[ground\]'"):
        mf.fly(uavs=2, duration=1, out=tmp_path, record=True)
    assert list(tmp_path.iterdir()) == []


def test_doctor_warns_of_a_library_that_no_flight_needs(monkeypatch) -> None:
    monkeypatch.setattr(doctor, "USES", {"no-such-package": "plots"})
    found = doctor._package("no-such-package")
    assert (found.verdict, found.remedy) == ("warning", "only needed for plots: pip install 'meanflock[ground]'")
