"""Plug-ins that print and start threads: neither ends up in what a command says, nor keeps a process from ending."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.polling import DEADLINE_S

pytestmark = [pytest.mark.processes]

PLUGIN = """
import threading
import time

import meanflock as mf

print("imported")


class Noisy(mf.Controller):
    name = "noisy"

    def __init__(self, options, scenario):
        super().__init__(options, scenario)
        print("made")

    def init(self, uavs, plan):
        threading.Thread(target=time.sleep, args=(1e6,)).start()
        return {}

    def step(self, memory, tick, own, received):
        print("tick", tick)
        return mf.Step(memory, -0.02 * own[:, :2])
"""


@pytest.mark.parametrize("mode", [["--in-process"], []])
def test_one_object_is_printed_and_the_command_ends_with_the_flight(tmp_path: Path, mode: list[str]) -> None:
    (tmp_path / "noisy.py").write_text(PLUGIN)
    line = [sys.executable, "-m", "meanflock", "run", "--plugin", "noisy.py", "--method", "noisy", *mode]
    line += ["--uavs", "2", "--duration", "1", "--no-record", "--json", "--quiet"]
    ended = subprocess.run(line, cwd=tmp_path, capture_output=True, text=True, timeout=DEADLINE_S)
    assert ended.returncode == 0, ended.stderr
    assert json.loads(ended.stdout)["ticks"] == 10


def test_the_list_of_plug_ins_is_json_alone(tmp_path: Path) -> None:
    (tmp_path / "noisy.py").write_text(PLUGIN)
    line = [sys.executable, "-m", "meanflock", "plugins", "--plugin", "noisy.py", "--json"]
    ended = subprocess.run(line, cwd=tmp_path, capture_output=True, text=True, timeout=DEADLINE_S, check=True)
    assert "noisy" in {entry["name"] for entry in json.loads(ended.stdout)}
    assert "imported" in ended.stderr


def test_a_study_puts_its_workers_away_before_it_ends(tmp_path: Path) -> None:
    line = [sys.executable, "-m", "meanflock", "compare", "cruise", "lqr", "--seeds", "2", "--jobs", "2", "--quiet"]
    line += ["--uavs", "2", "--duration", "1", "--out", str(tmp_path / "out")]
    ended = subprocess.run(line, cwd=tmp_path, capture_output=True, text=True, timeout=DEADLINE_S, check=True)
    assert ended.stderr == ""
