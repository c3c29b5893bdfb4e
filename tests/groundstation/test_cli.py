"""The command line: output, warnings, progress, the table at the end, and flights without Rerun."""

import io
import json
import os
import re
import sys

import msgspec
import numpy as np
import pytest
from rich.console import Console

import meanflock as mf
from meanflock import kernels
from meanflock.cli.command import _question_marks, main
from meanflock.kernels import sources
from meanflock.launch.engine import Engine
from meanflock.launch.progress import FlightProgress, summary_table
from meanflock.swarm.errors import EXIT_BAD_INPUT, EXIT_DONE
from meanflock.swarm.scenario import load
from meanflock.swarm.wire.messages import SWARM_COLUMNS
from tests.commands import COMMAND, printed
from tests.groundstation.conftest import QUICK
from tests.groundstation.recordings import flight


def test_a_flight_that_lost_uavs_names_the_first_and_the_reason(run) -> None:
    kill = "faults=[{kind='kill',tick=5,uavs=[2]}]"
    _, _, err = run(*QUICK, "--set", kill)
    said, folder = err.splitlines()
    name = folder.removeprefix("run folder ")
    assert re.fullmatch(rf"UAVs lost: 1; the first event: .*UAV 2.*; all events are in {name}/events\.jsonl", said)


@pytest.mark.usefixtures("undrawn")
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


@pytest.mark.parametrize(
    "terminal",
    [{"PYTHONIOENCODING": "latin-1"}, {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}],
    ids=lambda terminal: next(iter(terminal)),
)
def test_a_terminal_that_lacks_a_letter_shows_a_question_mark(terminal: dict[str, str], tmp_path) -> None:
    env = os.environ | terminal
    assert "alignment ?_A" in printed(*COMMAND, *QUICK, "--out", tmp_path, env=env, encoding="latin-1")


def test_bytes_of_a_path_that_are_no_text_are_printed_as_they_are() -> None:
    error = UnicodeEncodeError("ascii", "runs/\udcff\u03c6\u03c6", 5, 8, "ordinal not in range")
    assert _question_marks(error) == (b"\xff??", 8)


@pytest.mark.parametrize("group", [(), ("scenario",), ("certs",)])
def test_a_group_without_a_command_shows_its_help_and_says_why(run, group: tuple[str, ...]) -> None:
    code, out, err = run(*group)
    assert (code, out) == (EXIT_BAD_INPUT, "")
    assert err.startswith(" ".join(["Usage: meanflock", *group]))
    assert err.endswith("\n\nerror: name one of these commands\n")


FLOWN = load(None, ["uavs=2", "method=mfg", "duration=1", 'stop="duration"'])


@pytest.mark.parametrize("realtime", [100.0, None])
def test_the_line_and_the_table_have_late_commands_in_real_time_alone(realtime: float | None) -> None:
    bar = FlightProgress(FLOWN, quiet=True, console=Console(file=io.StringIO(), width=200))
    engine = Engine(FLOWN, "shown", sinks=[bar], realtime=realtime)
    for tick in engine.fly():
        if tick == 3 and realtime is not None:
            assert "held" not in str(bar._bar.tasks[0].fields["detail"])
            engine.world.counters.late(1234)
    line = str(bar._bar.tasks[0].fields["detail"])
    out = io.StringIO()
    Console(file=out, width=120).print(summary_table(engine.finish(), None))
    table = out.getvalue()
    assert "arrived" in line
    assert ("held 1234 in 1 late ticks" in line, "held" in line) == (realtime is not None, realtime is not None)
    for words in ("1,234", "deadline misses", "of 10 ticks", "tick starts late by, 99 %"):
        assert (words in table) == (realtime is not None)


@pytest.mark.parametrize(
    ("lost", "rejoined", "says"),
    [
        (0, 0, ""),
        (3, 0, "0 rejoined"),
        (3, 2, "2 rejoined: agents among them began anew, without what they had learned"),
    ],
)
def test_the_first_line_of_a_summary_says_that_agents_began_anew(lost: int, rejoined: int, says: str) -> None:
    engine = Engine(FLOWN, "shown")
    engine.world.counters.nodes_lost, engine.world.counters.nodes_rejoined = lost, rejoined
    table = summary_table(engine.complete(), None)
    names, numbers, remarks = (list(column.cells) for column in table.columns)
    assert (names[0] == "processes lost") == (lost > 0)
    assert ((numbers[0], remarks[0]) == (str(lost), says)) == (lost > 0)


@pytest.mark.parametrize("width", [60, 80, 160])
def test_no_number_is_cut_off_on_a_narrow_terminal(width: int) -> None:
    out = io.StringIO()
    terminal = Console(file=out, width=width, force_terminal=True, color_system=None)
    flown = load(None, ["uavs=25", "method=mfg"])
    with FlightProgress(flown, quiet=False, console=terminal) as bar:
        swarm = np.zeros((1, len(SWARM_COLUMNS)))
        for name, number in (("arrived", 21), ("uplink_bits", 12_345_678), ("held_commands", 1234)):
            swarm[:, SWARM_COLUMNS.index(name)] = number
        (block,) = flight(ticks=20)
        bar.write(msgspec.structs.replace(block, first_tick=2345, states=block.states[:1], swarm=swarm))
        bar._bar.refresh()
    lines = [line for line in re.split(r"[\r\n]|\x1b\[[0-9;?]*[A-Za-z]", out.getvalue()) if "flying" in line]
    assert lines
    for line in lines:
        assert "2345/3000 ticks" in line
        assert "234.5 s" in line
        assert "…" not in line
        assert len(line.rstrip()) <= width
        assert ("arrived 21/25" in line) == (width >= 80)
        assert ("held 1234 in 0 late ticks  12.35 Mbit" in line) == (width >= 160)


def test_there_is_no_bar_without_a_terminal() -> None:
    out = io.StringIO()
    with FlightProgress(FLOWN, quiet=False, console=Console(file=out, width=80)) as bar:
        bar.say("joining")
    assert out.getvalue() == ""


LINE = "no recording.rrd is written: rerun is not installed; pip install 'meanflock[ground]'\n"
FLIGHT = ["run", "--in-process", "--uavs", "2", "--duration", "5", "--json"]


def test_without_rerun_a_run_folder_is_the_same_but_for_the_recording(tmp_path, capsys, monkeypatch) -> None:
    assert main([*FLIGHT, "--out", str(tmp_path / "full")]) == 0
    full = json.loads(capsys.readouterr().out)
    monkeypatch.setitem(sys.modules, "rerun", None)
    assert main([*FLIGHT, "--out", str(tmp_path / "lean")]) == 0
    out, err = capsys.readouterr()
    lean = json.loads(out)
    assert lean == json.loads((tmp_path / "lean" / lean["run_id"] / "summary.json").read_text())
    assert err.count(LINE) == 1
    assert lean["trajectory_sha256"] == full["trajectory_sha256"]
    files = {kind: {path.name for path in (tmp_path / kind).glob("*/*")} for kind in ("full", "lean")}
    assert files["full"] - files["lean"] == {"recording.rrd"}
    assert not files["lean"] - files["full"]
    assert mf.open(tmp_path / "lean" / lean["run_id"]).recording is None
    with pytest.raises(mf.BadInput, match=r"record=True needs it: pip install 'meanflock\[ground\]'"):
        mf.fly(uavs=2, duration=1, out=tmp_path / "asked", record=True)
    assert not (tmp_path / "asked").exists()


@pytest.mark.parametrize("flag", ["--quiet", "--no-record", "--log-format=json"])
def test_nothing_is_said_where_nobody_listens_or_no_recording_is_wanted(flag, tmp_path, capsys, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    assert main([*FLIGHT, flag, "--out", str(tmp_path)]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["arrived"] is not None
    assert "rerun" not in err
