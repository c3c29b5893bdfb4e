"""The command line: its output, its warnings and its help."""

import json
import os
import re

import pytest

from meanflock import kernels
from meanflock.kernels import sources
from meanflock.swarm import scenario
from meanflock.swarm.errors import EXIT_BAD_INPUT, EXIT_DONE
from tests.commands import COMMAND, printed
from tests.groundstation.conftest import QUICK


def test_a_flight_that_lost_uavs_names_the_first_and_the_reason(run) -> None:
    kill = "faults=[{kind='kill',tick=5,uavs=[2]}]"
    _, _, err = run(*QUICK, "--set", kill)
    said, folder = err.splitlines()
    name = folder.removeprefix("run folder ")
    assert re.fullmatch(rf"UAVs lost: 1; the first event: .*UAV 2.*; all events are in {name}/events\.jsonl", said)


def test_json_is_exactly_the_summary_and_a_recording_changes_no_bit(run, tmp_path) -> None:
    hashes = set()
    for flag in ("--record", "--no-record"):
        flags = ("--json", "--uavs", "3", "--duration", "10", "--out", flag[2:])
        code, out, err = run("run", "--in-process", flag, *flags)
        assert code == EXIT_DONE
        (folder,) = (tmp_path / flag[2:]).iterdir()
        assert err.endswith(f"run folder {flag[2:]}/{folder.name}\n")
        assert json.loads(out) == json.loads((folder / "summary.json").read_text())
        hashes.add(json.loads(out)["trajectory_sha256"])
    assert len(hashes) == 1


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


def test_a_terminal_that_lacks_a_letter_shows_a_question_mark(tmp_path) -> None:
    env = os.environ | {"PYTHONIOENCODING": "latin-1"}
    assert "alignment ?_A" in printed(*COMMAND, *QUICK, "--out", tmp_path, env=env, encoding="latin-1")


@pytest.mark.parametrize("group", [(), ("scenario",), ("certs",)])
def test_a_group_without_a_command_shows_its_help_and_says_why(run, group: tuple[str, ...]) -> None:
    code, out, err = run(*group)
    assert (code, out) == (EXIT_BAD_INPUT, "")
    assert err.startswith(" ".join(["Usage: meanflock", *group]))
    assert err.endswith("\n\nerror: name one of these commands\n")
