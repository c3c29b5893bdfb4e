"""Folders whose names a library would take for a URI, a home folder or an option: flown, read and drawn like any."""

import os
from pathlib import Path

import pyarrow.parquet as pq
import pytest

import meanflock as mf
from meanflock.swarm.errors import EXIT_BAD_INPUT, EXIT_DONE
from tests.groundstation.conftest import QUICK

ODD = ("sigma:0.3", "file:x", "./~", "-x", "a b%20#?*", "λ")


@pytest.mark.parametrize("name", ODD)
def test_a_run_in_a_folder_with_an_odd_name_is_whole_and_read(run, tmp_path: Path, undrawn, name: str) -> None:
    code, _, err = run(*QUICK, f"--out={name}")
    assert (code, "Traceback" in err) == (EXIT_DONE, False)
    (folder,) = (tmp_path / name).iterdir()
    relative = f"./{folder.relative_to(tmp_path)}"
    with (folder / "timeseries.parquet").open("rb") as file:
        assert pq.read_table(file).num_rows == 21
    assert mf.open(relative).frame().num_rows == 21
    for verb in (("plot",), ("plot", "--csv", "rows.csv"), ("show",)):
        code, _, err = run(*verb, relative)
        assert (code, err) == (EXIT_DONE, "")
    assert len(undrawn) == 4


def test_a_recording_in_a_folder_with_an_odd_name_is_written(run, tmp_path: Path) -> None:
    flags = ("--in-process", "--quiet", "--uavs=2", "--duration=1")
    for name in ("-x", "sigma:0.3"):
        code, _, err = run("run", *flags, f"--out={name}")
        assert (code, "Traceback" in err) == (EXIT_DONE, False)
        (folder,) = (tmp_path / name).iterdir()
        assert (folder / "recording.rrd").stat().st_size > 1000


def test_a_tilde_is_the_home_folder_on_the_command_line_and_in_python(run, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert run(*QUICK, "--out=~/runs")[0] == EXIT_DONE
    (folder,) = (tmp_path / "home" / "runs").iterdir()
    assert run("show", f"~/runs/{folder.name}")[0] == EXIT_DONE
    flown = mf.fly(uavs=2, duration=1.0, out="~/flown")
    assert flown.folder is not None
    assert flown.folder.parent == tmp_path / "home" / "flown"
    flown.to_csv("~/rows.csv")
    assert flown.scenario.save("~/s.toml") == tmp_path / "home" / "s.toml"
    assert mf.Scenario.load("~/s.toml") == flown.scenario
    assert sorted(path.name for path in (tmp_path / "home").iterdir()) == ["flown", "rows.csv", "runs", "s.toml"]
    assert [path.name for path in tmp_path.iterdir()] == ["home"]


@pytest.mark.parametrize(
    "line",
    [
        (*QUICK, "--out", "BAD"),
        (*QUICK, "BAD"),
        (*QUICK, "--faults", "BAD"),
        ("run", "--plugin", "BAD"),
        ("compare", "hjb", "--out", "BAD"),
        ("list", "BAD"),
        ("list", "--html", "BAD"),
        ("plot", "BAD"),
        ("export", "x", "--mcap", "BAD"),
    ],
)
def test_a_path_that_is_not_utf_8_is_refused_before_take_off(run, tmp_path: Path, line: tuple[str, ...]) -> None:
    bad = os.fsdecode(b"caf\xe9")
    code, out, err = run(*(word.replace("BAD", bad) for word in line))
    assert (code, out, err.count("\n")) == (EXIT_BAD_INPUT, "", 1)
    assert "caf\\udce9: the path is not UTF-8" in err
    assert list(tmp_path.iterdir()) == []


def test_python_refuses_a_path_that_is_not_utf_8_before_take_off(tmp_path: Path) -> None:
    bad = tmp_path / os.fsdecode(b"caf\xe9")
    for refused in (
        lambda: mf.fly(uavs=2, duration=1.0, out=bad),
        lambda: mf.Stepped(uavs=2, duration=1.0, out=bad),
        lambda: mf.compare("hjb", seeds=1, uavs=2, duration=1.0, out=bad),
        lambda: mf.open(bad),
    ):
        with pytest.raises(mf.BadInput, match="not UTF-8"):
            refused()
    assert list(tmp_path.iterdir()) == []
