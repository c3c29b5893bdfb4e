"""The command line: what it flies, what it prints, and what it says of itself."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from meanflock import kernels
from meanflock.kernels import sources
from meanflock.swarm import scenario
from meanflock.swarm.errors import (
    EXIT_BAD_INPUT,
    EXIT_DONE,
    EXIT_RUN_FAILED,
    MeanflockError,
)
from meanflock.swarm.scenarios import shipped
from tests.groundstation.conftest import QUICK
from tests.polling import DEADLINE_S


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

    monkeypatch.setattr("meanflock.groundstation.doctor.examine", interrupt)
    code, _, err = run("doctor")
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


def test_a_terminal_that_lacks_a_letter_shows_a_question_mark(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "meanflock.groundstation.cli", *QUICK, "--out", str(tmp_path)]
    env = os.environ | {"PYTHONIOENCODING": "latin-1"}
    done = subprocess.run(command, env=env, capture_output=True, check=True, timeout=DEADLINE_S)
    assert "alignment ?_A" in done.stdout.decode("latin-1")


@pytest.mark.parametrize("group", [(), ("scenario",), ("certs",)])
def test_a_group_without_a_command_shows_its_help_and_says_why(run, group: tuple[str, ...]) -> None:
    code, out, err = run(*group)
    assert (code, out) == (EXIT_BAD_INPUT, "")
    assert err.startswith(" ".join(["Usage: meanflock", *group]))
    assert err.endswith("\n\nerror: name one of these commands\n")
