"""A learner on processes: the bits of one process, and the same after a process was killed."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from meanflock.swarm.errors import EXIT_DONE, EXIT_RUN_FAILED
from tests.commands import printed
from tests.sources import ROOT

pytestmark = pytest.mark.processes

FILE = ROOT / "tests" / "agent" / "learning" / "lines.py"
FLOWN = ("--method", "orca", "--uavs", "4", "--duration", "15", "--no-record", "--json", "--quiet", "--learner", FILE)
SLOW = ("training.fit_s=1.1", "training.spread=0.5", "training.power_W=2", "federation.fraction=1", "filter.kind=ecbf")


def summary(out: Path, *flags: str) -> dict[str, Any]:
    settings = (part for setting in SLOW for part in ("--set", setting))
    command = (sys.executable, "-m", "meanflock", "run", *FLOWN, *settings, "--out", out, *flags)
    return json.loads(printed(*command, env=os.environ | {"PYTHONPATH": str(ROOT)}, timeout=120))


def test_learners_in_one_process_and_in_one_each_have_the_same_bits(tmp_path: Path) -> None:
    one, two, four = (summary(tmp_path, *flags) for flags in (("--in-process",), ("--uavs-per-process", "2"), ()))
    assert one["lost"] == 0
    assert one["rounds"] >= 6
    for key in ("models_sha256", "trajectory_sha256", "payload_bits", "diagnostics", "energy_compute_J"):
        assert one[key] == two[key] == four[key], key


MISBEHAVING = FILE.with_name("misbehaving.py")


def flown(out: Path, how: str, *flags: str) -> tuple[int, dict[str, Any], str]:
    """Exit code of a flight of three UAVs, its summary, and its errors and events."""
    plugin = ("--learner", str(MISBEHAVING), "--set", f"training.options.how={how}")
    fixed = ("--method", "plan", "--uavs", "3", "--duration", "15", "--set", "stop=duration", "--no-record", "--json")
    command = (sys.executable, "-m", "meanflock", "run", *fixed, *plugin, "--out", str(out), *flags)
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=False)
    events = "".join(path.read_text(encoding="utf-8") for path in out.glob("*/events.jsonl"))
    return ended.returncode, json.loads(ended.stdout or "{}"), ended.stderr + events


def is_back(out: Path) -> bool:
    """Returns whether a new agent has taken the place of a dead one just before the flight ended."""
    lines = [line for path in out.glob("*/events.jsonl") for line in path.read_text(encoding="utf-8").splitlines()]
    changes = [kind for line in lines if (kind := json.loads(line)["kind"]) in ("lost", "rejoined")]
    return changes[-1:] == ["rejoined"]


@pytest.mark.parametrize(
    ("how", "flags", "lost", "said"),
    [
        ("exits", (), 1, "UAV 1 lost"),
        ("forks", (), 1, "a learner may start no process"),
        ("forks", ("--in-process",), 1, "a learner may start no process"),
        ("forks-in-a-thread", (), 1, "a learner may start no process"),
        ("forks-in-a-thread", ("--in-process",), 1, "a learner may start no process"),
        ("leaves-threads", (), 0, "of UAV 1 left 1 thread running; end them in `fit`"),
        ("leaves-threads", ("--in-process",), 0, "of UAV 1 left 1 thread running; end them in `fit`"),
    ],
)
def test_a_learner_that_misbehaves_loses_its_uav_or_is_told_and_the_flight_ends(
    tmp_path: Path, how: str, flags: tuple[str, ...], lost: int, said: str
) -> None:
    code, found, text = flown(tmp_path, how, *flags)
    assert (code, found["lost"] + is_back(tmp_path), found["ticks"]) == (EXIT_DONE, lost, 150)
    assert said in text


def test_a_learner_that_forks_on_every_uav_ends_the_flight(tmp_path: Path) -> None:
    code, _, text = flown(tmp_path, "forks-in-a-thread", "--in-process", "--set", "training.options.uavs=[0, 1, 2]")
    assert code == EXIT_RUN_FAILED
    assert "a learner may start no process" in text


def test_a_learner_that_ends_the_process_of_all_uavs_again_and_again_ends_the_flight(tmp_path: Path) -> None:
    code, _, text = flown(tmp_path, "exits", "--uavs-per-process", "3")
    assert code == EXIT_RUN_FAILED
    assert "agent process 0 ended with exit code 3" in text


def test_a_learner_whose_import_starts_a_thread_flies_and_the_cost_is_told(tmp_path: Path) -> None:
    file = tmp_path / "threaded.py"
    starts = "import threading\nthreading.Thread(target=threading.Event().wait, daemon=True).start()\n"
    file.write_text(starts + MISBEHAVING.read_text(encoding="utf-8"), encoding="utf-8")
    code, found, text = flown(tmp_path, "leaves-threads", "--learner", str(file), "--set", "training.options.uavs=[]")
    assert (code, found["lost"]) == (EXIT_DONE, 0)
    assert text.count("each process imports all libraries itself") == 1
