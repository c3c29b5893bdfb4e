"""A plug-in that prints and starts a thread disturbs neither the output of a command nor its end."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.polling import DEADLINE_S

pytestmark = pytest.mark.processes

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
FLIGHT = ("--method", "noisy", "--uavs", "2", "--duration", "1", "--no-record", "--quiet")


@pytest.mark.parametrize(
    "command",
    [("run", *FLIGHT), ("plugins",)],
    ids=["run", "list"],
)
def test_standard_output_is_json_alone(tmp_path: Path, command: tuple[str, ...]) -> None:
    (tmp_path / "noisy.py").write_text(PLUGIN)
    line = [sys.executable, "-m", "meanflock", *command, "--plugin", "noisy.py", "--json"]
    ended = subprocess.run(line, cwd=tmp_path, capture_output=True, text=True, timeout=DEADLINE_S)
    assert ended.returncode == 0, ended.stderr
    assert "imported" in ended.stderr
    printed = json.loads(ended.stdout)
    if command[0] == "run":
        assert printed["ticks"] == 10
    else:
        assert "noisy" in {entry["name"] for entry in printed}
