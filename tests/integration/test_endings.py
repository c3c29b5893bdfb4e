"""The end of commands and their processes, also before take-off; the variables that they inherit."""

import json
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import psutil
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from meanflock.cli.command import main
from meanflock.launch.children import environment
from meanflock.launch.processes import Swarm
from meanflock.launch.temporary import TemporaryFolder
from meanflock.net.process import CHILD
from meanflock.net.session import ZenohBus
from meanflock.results.quantities import VARYING
from tests.controller_files import controller_file
from tests.faults.by_hand import Process, Processes
from tests.faults.launched import alive
from tests.integration.conftest import Command, processes_of
from tests.polling import DEADLINE_S, until

pytestmark = pytest.mark.processes

SOON_S = 40.0  # what takes a moment, on a machine that is busy


def test_a_world_that_waits_for_its_nodes_does_not_outlive_its_launcher(processes: Processes) -> None:
    world = processes.start("worldsim", "--wait", "10000", env={CHILD: "1"})
    ZenohBus.client(processes.base[1], DEADLINE_S).close()
    world.communicate(timeout=SOON_S)  # closes its input, as when its launcher ends
    assert world.returncode == 1


def test_a_controller_that_hangs_does_not_outlive_a_launcher_that_is_killed(command: Command, tmp_path: Path) -> None:
    step = 'Path(__file__).with_suffix(".hangs").touch()\nwhile True:\n    pass'
    plugin = controller_file(tmp_path, "hangs", step, top="from pathlib import Path")
    launcher = command.start("--quiet", "--plugin", str(plugin), "--method", "hangs", "--uavs", "2", "--no-record")
    until(plugin.with_suffix(".hangs").exists, "a controller that hangs")
    assert len(processes_of(str(tmp_path))) >= 4  # launcher, forker, world and agents
    launcher.kill()
    until(lambda: not processes_of(str(tmp_path)), "the end of all processes", SOON_S)


def test_ctrl_c_tells_that_a_controller_hangs_in_this_process_and_once_more_ends_it(command, tmp_path) -> None:
    step = 'Path(__file__).with_suffix(".hangs").touch()\nwhile True:\n    pass'
    plugin = controller_file(tmp_path, "hangs", step, top="from pathlib import Path")
    flags = ("--in-process", "--quiet", "--plugin", str(plugin), "--method", "hangs", "--uavs", "2", "--no-record")
    launcher = command.start(*flags)
    until(plugin.with_suffix(".hangs").exists, "a controller that hangs")
    launcher.send_signal(signal.SIGINT)
    assert launcher.stderr.readline().startswith("interrupted; the flight is still being completed, or a plug-in hangs")
    launcher.send_signal(signal.SIGINT)
    _, err = launcher.communicate(timeout=SOON_S)
    assert (launcher.returncode, err.startswith("error: interrupted twice, nothing was completed; ")) == (1, True)


TWICE = """import os, signal, sys
from meanflock.cli.command import main
from meanflock.launch import outputs

def interrupted(*_):
    for _ in range(2):
        os.kill(os.getpid(), signal.SIGINT)

outputs.Outputs = interrupted
sys.exit(main(["run", "--quiet", *sys.argv[1:]]))
"""


@pytest.mark.parametrize("flags", [("--in-process",), ("--uavs", "2")])
def test_ctrl_c_twice_before_take_off_is_a_line_and_leaves_no_empty_folder(tmp_path: Path, flags) -> None:
    command = [sys.executable, "-c", TWICE, *flags, "--out", str(tmp_path / "runs")]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=SOON_S, check=False)
    assert (ended.returncode, ended.stdout) == (1, "")
    assert ended.stderr == "error: interrupted twice, before take-off; repeat the command\n"
    assert list((tmp_path / "runs").iterdir()) == []
    until(lambda: not processes_of(str(tmp_path)), "the end of all processes", SOON_S)


def test_the_folder_of_a_launcher_that_is_killed_is_deleted_by_the_next(command, tmp_path, monkeypatch) -> None:
    place = tmp_path / "temporary"
    place.mkdir()
    monkeypatch.setenv("TMPDIR", str(place))
    monkeypatch.setattr(tempfile, "tempdir", None)
    foreign = place / "meanflock-of-another-program"
    foreign.mkdir()
    flags = ("--quiet", "--uavs", "2", "--no-record", "--set", "stop=duration", "--duration", "100000")
    launcher = command.start(*flags)
    until(lambda: len(held := set(place.glob("meanflock-*/.locked"))) == 2 and held, "its folders")
    with TemporaryFolder() as own:
        assert len(set(place.glob("meanflock-*/.locked"))) == 3  # of a process that lives, none is deleted
        launcher.kill()
        launcher.wait()
        with TemporaryFolder() as other:
            assert set(place.iterdir()) == {foreign, own.path, other.path}
    assert set(place.iterdir()) == {foreign}


def test_ctrl_c_ends_a_ground_station_that_waits_for_a_world(tmp_path: Path, processes: Processes) -> None:
    station = processes.station(tmp_path, "--wait", "10000")
    until(lambda: psutil.Process(station.pid).num_threads() > 2, "it looks for the world")
    station.send_signal(signal.SIGINT)
    _, err = station.communicate(timeout=SOON_S)
    assert (station.returncode, list(tmp_path.iterdir())) == (1, [])
    assert "error: interrupted" in err


def test_a_complete_flight_keeps_its_summary_if_processes_do_not_end(command, monkeypatch, capsys) -> None:
    monkeypatch.setattr(Swarm, "wait", lambda swarm, timeout_s: ["agent-1"])
    flags = ("--uavs", "2", "--duration", "5", "--no-record", "--out", str(command.out))
    assert main(["run", "--quiet", "--json", *flags]) == 0
    flown, warned = capsys.readouterr()
    assert json.loads(flown) == json.loads((command.folder / "summary.json").read_text())
    assert "the flight is complete, but not all processes ended within 15 s of it; ended now: agent-1" in warned
    until(lambda: not processes_of(str(command.out.parent)), "the end of all processes", SOON_S)


@pytest.mark.parametrize(("step", "error"), [("breakpoint()", "BdbQuit"), ("input()", "EOFError")])
def test_a_controller_that_reads_the_terminal_fails_at_once(step, error, command, tmp_path, capsys) -> None:
    plugin = controller_file(tmp_path, "asks", step)
    flags = ("--plugin", str(plugin), "--method", "asks", "--uavs", "2", "--no-record", "--out", str(command.out))
    assert main(["run", "--quiet", *flags]) == 1
    said = capsys.readouterr().err
    assert said.startswith("error: every UAV was lost: agent-0: controller 'asks' failed with UAV 0: "), said
    assert error in said


CODING = """import meanflock as mf
import numpy as np

class Mine(mf.Coding):
    name = "mine"

    def encode(self, models):
        if models.round == {last} and 1 in models.uavs:
            raise KeyError("table")
        numbers = np.clip(np.rint(models.numbers * 8), -127, 127).astype("i1")
        return numbers, np.ones((len(numbers), len(models.starts)), np.float32)

    def decode(self, numbers, scales):
        return numbers / 8.0
"""


@pytest.mark.parametrize("duration_s", [100.0, 4.6], ids=["in the middle", "in the last tick"])
def test_a_coding_that_fails_ends_the_flight_as_in_one_process(duration_s, command, tmp_path, capsys) -> None:
    (plugin := tmp_path / "mine.py").write_text(CODING.format(last=3), encoding="utf-8")
    settings = ("federation.payload=mine", "federation.period=15", "federation.fraction=1", "stop=duration")
    words = [word for setting in settings for word in ("--set", setting)]
    flags = ("--uavs", "3", "--duration", str(duration_s), "--no-record", "--out", str(command.out), *words)
    said = []
    for mode in ("--in-process", "--uavs-per-process=2"):
        assert main(["run", "--quiet", "--plugin", str(plugin), mode, *flags]) == 1
        error, folder = capsys.readouterr().err.splitlines()[-2:]
        assert folder.startswith(f"{command.out}{os.sep}"), folder
        said.append(error)
    assert said == ["error: coding 'mine': `encode` failed: KeyError: 'table' (mine.py, line 9)"] * 2
    assert not list(command.out.glob("*/summary.json"))


VEHICLE = """import meanflock as mf
import numpy as np

class Mine(mf.Vehicle):
    name = "mine"

    def init(self, uavs):
        return {"ticks": np.zeros(uavs)}

    def step(self, states, hidden, acceleration, noise):
        return states, {"ticks": hidden["ticks"] + 1}

    def power(self, states, hidden, acceleration):
        if hidden["ticks"].max() > 120:
            raise ValueError("flat")
        return np.ones(len(states))
"""


@pytest.mark.parametrize("mode", ["--in-process", "--uavs-per-process=2"])
def test_the_power_of_a_vehicle_that_fails_is_the_error_and_the_last_event_of_the_flight(mode, command, capsys) -> None:
    (plugin := command.out.parent / "mine.py").write_text(VEHICLE, encoding="utf-8")
    flags = ("--plugin", str(plugin), "--set", "vehicle.model=mine", "--uavs", "2", "--method", "hjb", "--no-record")
    assert main(["run", "--quiet", "--out", str(command.out), mode, *flags]) == 1
    failure = "vehicle 'mine': `power` failed: ValueError: flat (mine.py, line 15)"
    began, *_, ended = capsys.readouterr().err.splitlines()
    assert began.startswith({"--in-process": f"error: {failure}"}.get(mode, "error: world ended with exit code 1; its"))
    assert ended.startswith(f"{command.folder} has the flight up to tick "), ended
    last = json.loads((command.folder / "events.jsonl").read_text(encoding="utf-8").splitlines()[-1])
    assert (last["event"], last["fields"]["reason"].startswith(failure)) == ("flight-failed", True)
    assert (
        pq.read_metadata(command.folder / "timeseries.parquet").num_rows == last["tick"]
    )  # none of the tick that failed
    assert main(["show", str(command.folder)]) == 0
    assert f"It failed: {failure}" in " ".join(capsys.readouterr().out.split())


def test_processes_inherit_only_the_variables_that_are_theirs(command, monkeypatch) -> None:
    flags = ("--uavs", "2", "--duration", "5", "--no-record")
    expected = command.summary("--in-process", *flags)
    for name, said in {"SET": "uavs=3 wind.sigma=2", "UAV": "1", "RESUME": "/nowhere", "TLS": "/nowhere"}.items():
        monkeypatch.setenv(f"MEANFLOCK_{name}", said)
    flown = command.summary(*flags)
    for key in ("scenario_sha256", "trajectory_sha256"):
        assert flown[key] == expected[key]
    for name in ("RUN", "SET", "COUNT", "MEANFLOCK_BARRIER", "MEANFLOCK_RUN", "MEANFLOCK_SET", "MEANFLOCK_COUNT"):
        monkeypatch.setenv(name, "given")
    inherited = {name for name, value in environment().items() if value == "given"}
    assert inherited == {"RUN", "SET", "COUNT", "MEANFLOCK_BARRIER"}


LONG = ("--seeds", "500", "--uavs", "9", "--duration", "200", "--set", "stop=duration", "--jobs", "2", "--quiet")


def workers_of(study: Process) -> list[psutil.Process]:
    """Those it has, as soon as there are two."""

    def found() -> list[psutil.Process]:
        return [p for p in psutil.Process(study.pid).children() if "multiprocessing.spawn" in " ".join(p.cmdline())]

    return until(lambda: workers if len(workers := found()) == 2 else [], "workers", pause_s=0.01)


@pytest.mark.parametrize(
    ("number", "to_all"),
    [
        (signal.SIGTERM, False),
        (signal.SIGINT, True),  # as the group of a terminal gets Ctrl-C, while workers start
        (signal.SIGKILL, False),
    ],
)
def test_a_study_that_is_ended_leaves_no_worker_and_can_be_continued(number, to_all, tmp_path, processes) -> None:
    study = processes.start("cli", "compare", "mfg", *LONG, "--out", str(tmp_path), base=())
    workers = workers_of(study)
    if number == signal.SIGKILL:
        until(lambda: list((tmp_path / "data" / "jobs").glob("*")), "a flight that is finished")
    for process in (*workers, study) if to_all else (study,):
        process.send_signal(number)
    _, err = study.communicate(timeout=DEADLINE_S)
    if number != signal.SIGKILL:
        assert (study.returncode, err.count("\n")) == (1, 1), err
        assert err.startswith("error: interrupted; ")
        assert "repeat the command to fly the rest" in err
    until(lambda: not any(map(alive, workers)), "no worker", SOON_S)


REST = ("compare", "mfg", "--seeds", "20", "--uavs", "9", "--duration", "60", "--set", "stop=duration", "--quiet")


def tables(out: Path) -> tuple[bytes, pa.Table]:
    """Means of a study, and its flights without the times that they took."""
    flights = pq.read_table(out / "flights.parquet")
    return (out / "compare.csv").read_bytes(), flights.drop_columns([*VARYING & set(flights.column_names)])


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, pa.Table]:
    out = tmp_path_factory.mktemp("undisturbed")
    assert main([*REST, "--jobs", "1", "--out", str(out)]) == 0
    return tables(out)


@pytest.mark.xdist_group("the rest of a study")
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_a_study_that_was_ended_flies_the_rest_to_the_tables_of_an_undisturbed_one(
    number, undisturbed, tmp_path, processes
) -> None:
    def finished() -> dict[str, int]:
        return {path.name: path.stat().st_ino for path in (tmp_path / "data" / "jobs").glob("*.job")}

    study = processes.start("cli", *REST, "--jobs", "2", "--out", str(tmp_path), base=())
    until(finished, "a flight that is finished", pause_s=0.005)
    study.send_signal(number)
    study.communicate(timeout=DEADLINE_S)
    flights_kept = finished()
    assert 0 < len(flights_kept) < 20
    assert main([*REST, "--jobs", "2", "--out", str(tmp_path)]) == 0
    assert flights_kept.items() <= finished().items()
    assert len(finished()) == 20
    assert tables(tmp_path) == undisturbed


def test_show_finds_why_a_flight_failed_by_an_error_of_a_megabyte(command, capsys) -> None:
    (plugin := command.out.parent / "mine.py").write_text(VEHICLE.replace('"flat"', '"flat" + 10**6 * "🛩"'))
    flags = ("--plugin", str(plugin), "--set", "vehicle.model=mine", "--uavs", "2", "--method", "hjb", "--no-record")
    assert main(["run", "--quiet", "--out", str(command.out), "--in-process", *flags]) == 1
    capsys.readouterr()
    assert main(["show", str(command.folder)]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "It failed: vehicle 'mine': `power` failed: ValueError: flat🛩" in shown
    assert len(shown) < 5000
