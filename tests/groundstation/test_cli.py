"""The command line: what it refuses, how it says so, and that a refusal leaves nothing behind."""

import json
import os
import re
import socket
import subprocess
import sys
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from meanflock import kernels
from meanflock.groundstation import display, viewer
from meanflock.groundstation.engine import Engine
from meanflock.groundstation.recorded import recorded
from meanflock.groundstation.recording import Recorder
from meanflock.groundstation.results import RunFolder
from meanflock.groundstation.viewer import verify
from meanflock.kernels import sources
from meanflock.swarm import scenario
from meanflock.swarm.errors import (
    EXIT_BAD_INPUT,
    EXIT_DONE,
    EXIT_RUN_FAILED,
    MeanflockError,
    RunFailed,
)
from meanflock.swarm.scenarios import shipped
from tests.polling import DEADLINE_S

QUICK = ("run", "--in-process", "--no-record", "--quiet", "--uavs", "3", "--duration", "2")


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        (("--set", "wind.sgima=0.1"), "sgima"),
        (("--set", "wind.sigma=strong"), "wind.sigma"),
        (("--set", "wind.sigma=-1"), "wind.sigma"),
        (("--set", "wind.sigma=nan"), "wind.sigma"),
        (("--set", "radio.rice_chi=0"), "radio.rice_chi"),
        (("--set", "nonsense"), "key=value"),
        (("--uavs", "0"), "uavs"),
        (("--uavs", "-3"), "uavs"),
        (("--uavs", "many"), "--uavs"),
        (("--seed", "-1"), "seed"),
        (("--duration", "nan"), "duration"),
        (("--method", "magic"), "mfgfl-hf"),
        (("--set", "federation.leader=3"), "federation.leader"),
        (("--set", "federation.period=0"), "federation.period"),
        (("missing.toml",), "missing.toml: No such file or directory; give a readable scenario file"),
        (("--faults", "missing.toml"), "missing.toml: No such file or directory; give a readable fault script"),
        (("--endpoint", "127.0.0.1:7556"), "127.0.0.1:7556: write it as tcp/HOST:PORT, for example tcp/127.0.0.1:"),
        (("--endpoint", "tcp/localhost"), "tcp/localhost: write it as tcp/HOST:PORT"),
        (("--endpoint", "tcp/127.0.0.1:99999"), "99999: write it as tcp/HOST:PORT"),
        (("--uavs-per-process", "0"), "--uavs-per-process"),
        (("--realtime", "0"), "--realtime"),
        (("--realtime=-2",), "--realtime -2: how many times faster"),
        (("--realtime", "-.5"), "--realtime -.5: how many times faster"),
        (("--realtime", "nan"), "--realtime nan"),
        (("--metrics", "everywhere"), "--metrics everywhere: write it as PORT or HOST:PORT"),
        (("--log-format", "xml"), "json"),
        (("--no-such-flag",), "--no-such-flag"),
        (("--set", "controller.sped=2"), "controller: there is no key `sped`"),
        (("--set", "federation.options.beta=2"), "federation.options: there is no key `beta`"),
    ],
)
def test_bad_input_is_one_line_that_names_it_and_nothing_is_written(run, tmp_path, flags, says) -> None:
    code, out, err = run(*QUICK, *flags)
    assert code == EXIT_BAD_INPUT
    assert out == ""
    assert err.startswith("error: ")
    assert err.strip().count("\n") == 0
    assert says in err
    assert list(tmp_path.iterdir()) == []


def test_a_scenario_file_that_is_no_toml_or_not_readable(run, tmp_path) -> None:
    (tmp_path / "bad.toml").write_text("uavs = = 3")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    for name in ("bad.toml", "binary.toml", "."):
        code, _, err = run(*QUICK, name)
        assert code == EXIT_BAD_INPUT
        assert err.strip().count("\n") == 0
    assert not (tmp_path / "runs").exists()


def test_an_output_folder_that_cannot_be_written(run, tmp_path) -> None:
    (tmp_path / "file").write_text("")
    code, _, err = run(*QUICK, "--out", "file/runs")
    assert code == EXIT_BAD_INPUT
    assert "--out" in err
    assert os.listdir(tmp_path) == ["file"]


def test_an_occupied_port_leaves_nothing_behind(run, tmp_path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        code, _, err = run("run", "--quiet", "--no-record", "--uavs", "2", "--endpoint", f"tcp/127.0.0.1:{port}")
    assert code == EXIT_BAD_INPUT
    assert str(port) in err
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    "flags", [("--uavs", "90000"), ("--uavs", "90000", "--in-process", "--method", "hjb")], ids=["processes", "pairs"]
)
def test_a_swarm_that_does_not_fit_into_memory_is_refused_with_the_estimate(run, tmp_path, flags) -> None:
    code, _, err = run("run", "--quiet", *flags)
    assert code == EXIT_BAD_INPUT
    assert re.search(r"memory: \d+ MB for 90000 UAVs in .*process.*, \d+ MB (available|left of)", err)
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize("uavs", [1, 2, 7, 200])
def test_one_uav_a_number_that_is_no_square_and_many_in_one_process_fly(run, uavs) -> None:
    code, out, _ = run(
        "run", "--in-process", "--no-record", "--uavs", str(uavs), "--duration", "2", "--json", "--quiet"
    )
    assert code == EXIT_DONE
    summary = json.loads(out)
    assert summary["ticks"] == 20
    assert (summary["phi_C_distinct"] is None) == (uavs == 1)


def test_who_was_lost_and_why_is_said_after_the_flight(run) -> None:
    kill = "faults=[{kind='kill',tick=5,uavs=[2]}]"
    _, _, err = run(*QUICK, "--set", kill)
    said, folder = err.splitlines()
    name = folder.removeprefix("run folder ")
    assert re.fullmatch(rf"UAVs lost: 1; the first event: .*UAV 2.*; all events are in {name}/events\.jsonl", said)


def test_json_is_exactly_the_summary_even_with_progress(run, tmp_path) -> None:
    code, out, _ = run("run", "--in-process", "--no-record", "--json", "--uavs", "3", "--duration", "2")
    assert code == EXIT_DONE
    (folder,) = (tmp_path / "runs").iterdir()
    assert json.loads(out) == json.loads((folder / "summary.json").read_text())


@pytest.mark.parametrize("flags", [(), ("--quiet",), ("--quiet", "--json")])
def test_the_run_folder_is_named_however_quiet(run, tmp_path, flags) -> None:
    code, _, err = run("run", "--in-process", "--no-record", "--uavs", "2", "--duration", "1", *flags)
    (folder,) = (tmp_path / "runs").iterdir()
    assert (code, err) == (EXIT_DONE, f"run folder runs/{folder.name}\n")


@pytest.mark.parametrize(
    "verb",
    [("run", "--in-process", "--no-record"), ("compare", "mfg", "--seeds", "1"), ("sweep", "seed=1,2")],
    ids=lambda verb: verb[0],
)
def test_a_run_without_compiled_kernels_says_that_it_is_slow(run, monkeypatch, verb) -> None:
    flags = ("--uavs", "2", "--duration", "1", "--quiet")
    assert "kernels" not in run(*verb, *flags)[2]
    monkeypatch.setattr(kernels, "BACKEND", "numpy")
    monkeypatch.setattr(sources, "built", lambda: False)
    monkeypatch.delenv("MEANFLOCK_PURE", raising=False)
    code, _, err = run(*verb, *flags)
    assert code == EXIT_DONE
    (said,) = [line for line in err.splitlines() if "kernels" in line]
    assert re.match(r"warning: kernels not compiled: NumPy's, .* slower; install a C compiler", said)


def test_show_prints_a_scenario_that_loads_as_the_same(run, tmp_path) -> None:
    code, out, _ = run("scenario", "show", "--method", "hjb", "--uavs", "9", "--set", "wind.sigma=0.3")
    assert code == EXIT_DONE
    path = tmp_path / "shown.toml"
    path.write_text(out)
    wanted = scenario.load(None, ["wind.sigma=0.3"], method="hjb", uavs=9)
    assert scenario.load(path).sha256() == wanted.sha256()


def test_schema_is_json(run) -> None:
    code, out, _ = run("scenario", "schema")
    assert code == EXIT_DONE
    assert "$defs" in json.loads(out)


def test_view_of_a_folder_without_a_recording_says_so(run, tmp_path) -> None:
    code, _, err = run("view", str(tmp_path))
    assert code == EXIT_BAD_INPUT
    assert "recording" in err


def test_view_of_a_killed_run_opens_its_recording_filled_from_its_time_series(run, tmp_path, monkeypatch) -> None:
    flown = scenario.load(None, ["duration=12", "stop=duration"], uavs=3)
    folder = RunFolder(tmp_path, "killed", flown)
    recorder = Recorder(flown, "killed", folder.path / "recording.rrd")
    for _ in Engine(flown, "killed", sinks=[folder, recorder]).fly():
        pass
    recorder._pending = []  # as after kill -9: nothing is sent, nothing completed
    recorder.close()
    with (folder.path / "recording.rrd").open("r+b") as file:
        file.truncate(file.seek(0, os.SEEK_END) - 100)
    folder._background.wait()
    folder._spool = None  # type: ignore[assignment]
    folder._events.close()
    opened: list[Path] = []

    def close_at_once(path: Path) -> "subprocess.Popen[bytes]":
        opened.append(path)
        return subprocess.Popen(["true"])

    monkeypatch.setattr(display, "check", lambda _: None)
    monkeypatch.setattr(viewer, "open_viewer", close_at_once)
    code, _, _ = run("view", str(folder.path))
    assert (code, opened) == (EXIT_DONE, [folder.path / "recording.rrd"])
    rows = len(pq.read_table(folder.path / "timeseries.parquet"))
    assert recorded(opened).ticks.tolist() == list(range(rows))
    assert rows > 100


@pytest.mark.parametrize("verb", [("view", "--web"), ("plot",), ("picture", "-o", "p.png")], ids=" ".join)
def test_a_run_that_still_flies_is_not_completed_under_its_hands(run, tmp_path, verb) -> None:
    flown = scenario.load(None, ["duration=4", "stop=duration"], uavs=3)
    with (
        RunFolder(tmp_path, "flying", flown) as folder,
        Recorder(flown, "flying", folder.path / "recording.rrd") as recorder,
    ):
        engine = Engine(flown, "flying", sinks=[folder, recorder])
        for tick in engine.fly():
            if tick == 30:
                code, _, err = run(*verb, str(folder.path))
                assert (code, err.count("\n")) == (EXIT_BAD_INPUT, 1)
                assert "still writes this run" in err
        engine.world.finish()
    assert verify(folder.path / "recording.rrd") is None
    assert recorded([folder.path / "recording.rrd"]).ticks[-1] == 40
    assert len(pq.read_table(folder.path / "timeseries.parquet")) == 41


@pytest.fixture
def flown(run, tmp_path) -> Path:
    """The folder of a recorded flight of 2 s."""
    assert run("run", "--in-process", "--quiet", "--uavs", "2", "--duration", "2")[0] == EXIT_DONE
    (folder,) = (tmp_path / "runs").iterdir()
    return folder


@pytest.mark.parametrize("at", [None, "127.0.0.1:77", ":77", "elsewhere"])
def test_without_a_display_view_fails_and_says_what_works(run, monkeypatch, flown, at) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    if at is not None:
        monkeypatch.setenv("DISPLAY", at)
    code, out, err = run("view", str(flown))
    assert (code, out, err.count("\n")) == (EXIT_RUN_FAILED, "", 1)
    for part in ("no display", f"meanflock picture {flown}", f"meanflock view {flown} --web", at or "DISPLAY"):
        assert part in err


def test_without_a_display_run_view_fails_before_anything_is_flown(run, tmp_path, monkeypatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    code, _, err = run("run", "--in-process", "--view", "--uavs", "2", "--duration", "2")
    assert code == EXIT_RUN_FAILED
    assert "meanflock picture" in err
    assert list(tmp_path.iterdir()) == []


def test_a_display_is_one_at_which_somebody_listens(tmp_path, monkeypatch) -> None:
    for name in ("DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setenv("WAYLAND_DISPLAY", "wayland-7")
    with pytest.raises(RunFailed, match="nobody answers at WAYLAND_DISPLAY=wayland-7; instead"):
        display.check("instead")
    with socket.socket(socket.AF_UNIX) as compositor:
        compositor.bind(str(tmp_path / "wayland-7"))
        compositor.listen()
        display.check("instead")


def test_a_viewer_that_ends_with_an_error_is_a_failure(run, monkeypatch, flown) -> None:
    monkeypatch.setattr(display, "check", lambda _: None)
    monkeypatch.setattr(viewer, "_program", lambda: ["false"])
    monkeypatch.setattr("meanflock.groundstation.cli_look._complete", lambda *_: None)
    code, _, err = run("view", str(flown))
    assert code == EXIT_RUN_FAILED
    assert "the viewer ended with 1" in err


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        (("-o", "p.jpg"), ".png"),
        (("-o", "p.png", "--size", "1920"), "WIDTHxHEIGHT"),
        (("-o", "p.png", "--size", "20x-20"), "WIDTHxHEIGHT"),
        (("-o", "file/p.png"), "file/p.png"),
        ((), "-o"),
    ],
)
def test_a_picture_that_cannot_be_drawn_is_refused(run, tmp_path, flown, flags, says) -> None:
    (tmp_path / "file").write_text("")
    code, _, err = run("picture", str(flown), *flags)
    assert (code, err.count("\n")) == (EXIT_BAD_INPUT, 1)
    assert says in err
    assert not list(tmp_path.rglob("*.png"))


def test_doctor_reports_everything_and_fails_where_a_run_would(run) -> None:
    code, out, _ = run("doctor", "--uavs", "4")
    assert code == EXIT_DONE
    for word in ("Python", "numpy", "memory", "loopback", "output folder"):
        assert word in out
    code, out, _ = run("doctor", "--uavs", "9000")
    assert code == 1
    assert "fails" in out


def test_the_recorder_does_not_alter_the_flight(run) -> None:
    flags = ("run", "--in-process", "--json", "--quiet", "--uavs", "4", "--duration", "10")
    hashes = {json.loads(run(*flags, record)[1])["trajectory_sha256"] for record in ("--record", "--no-record")}
    assert len(hashes) == 1


@pytest.mark.parametrize(("group", "least"), [((), 11), (("scenario",), 2), (("certs",), 1)])
def test_no_line_of_the_list_of_commands_is_cut_off_at_80_columns(run, monkeypatch, group, least) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    code, out, _ = run(*group, "--help")
    assert code == EXIT_DONE
    listed = out.partition("Commands:\n")[2].splitlines()
    assert len(listed) >= least
    assert [line for line in listed if line.endswith("...")] == []


def test_help_names_every_scenario_that_can_be_flown_by_its_name(run) -> None:
    said = run("run", "--help")[1]
    assert [path.stem for path in shipped() if f"{path.stem}," not in said and f"{path.stem}." not in said] == []


def test_who_is_interrupted_is_told_so(run, monkeypatch) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("meanflock.groundstation.plots.plot_compare", interrupt)
    code, _, err = run("compare", "plan", "--seeds", "1", "--uavs", "2", "--duration", "1", "--quiet")
    assert (code, err.strip()) == (EXIT_RUN_FAILED, "error: interrupted")


def test_the_module_has_the_verbs_the_command_has(run) -> None:
    command = [sys.executable, "-m", "meanflock.groundstation.cli", "--help"]
    told = subprocess.run(command, capture_output=True, text=True, check=True, timeout=DEADLINE_S).stdout
    for verb in ("run", "view", "picture", "compare", "sweep", "plot"):
        assert f"\n  {verb} " in told
        assert f"\n  {verb} " in run("--help")[1]


def test_every_exit_code_has_a_help_text(run) -> None:
    def codes(kind: type[MeanflockError]) -> set[int]:
        return {kind.exit_code}.union(*map(codes, kind.__subclasses__()))

    told = run("--help")[1].partition("Exit codes:\n")[2].partition("\n\n")[0]
    assert {int(code) for code in re.findall(r"^ +(\d)  \w", told, re.MULTILINE)} == codes(MeanflockError) | {EXIT_DONE}
