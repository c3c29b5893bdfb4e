"""Plug-ins that raise in any method end a command with one error; plug-ins that print disturb no output."""

import json
import shutil
import sys
from pathlib import Path

import pytest

from meanflock.swarm.errors import EXIT_BAD_INPUT, EXIT_DONE, EXIT_RUN_FAILED
from tests.commands import ended

PLUGINS = """
import meanflock as mf
from tests.testing.good import GoodAggregator, GoodChannel, GoodController, GoodFilter, GoodVehicle


class Odd(BaseException):
    pass


def fail(*_):
    raise RAISED


class Pilot(GoodController):
    name = "pilot"
    period_ticks = 4

    class Options(mf.Options, frozen=True):
        def __post_init__(self):
            if "METHOD" == "Options.__post_init__":
                fail()


class Shield(GoodFilter):
    name = "shield"


class Rule(GoodAggregator):
    name = "rule"


class Air(GoodChannel):
    name = "air"


class Craft(GoodVehicle):
    name = "craft"


owner, _, method = "METHOD".partition(".")
if owner == "import":
    fail()
elif owner not in ("nowhere", "Options"):
    setattr(globals()[owner], method, property(fail) if method == "weights" else fail)
"""
OF_A_CONTROLLER = ("__init__", "weights", "init", "prediction")
BEFORE_TAKE_OFF = ("import", "Options.__post_init__", *(f"Pilot.{name}" for name in OF_A_CONTROLLER))
BEFORE_TAKE_OFF += ("Rule.init", "Craft.init")
IN_FLIGHT = ("Pilot.step", "Shield.admit", "Air.transmit", "Air.expected", "Craft.step", "Craft.power")
A_ROUND = ("Rule.step",)  # costs that round and no more
FLIGHT = ("--plugin", "mine.py", "--method", "pilot", "--uavs", "2", "--duration", "1", "--quiet", "--out", "runs")
SETTINGS = ("filter.kind=shield", "federation.aggregation=rule", "radio.model=air", "vehicle.model=craft")


@pytest.mark.parametrize("raised", ["RuntimeError('no')", "SystemExit(0)", "Odd('no')"])
def test_a_command_ends_with_one_error_whatever_a_plugin_raises(run, tmp_path, raised: str) -> None:
    expected = dict.fromkeys(BEFORE_TAKE_OFF, EXIT_BAD_INPUT)
    expected |= dict.fromkeys(IN_FLIGHT, EXIT_RUN_FAILED) | dict.fromkeys(A_ROUND, EXIT_DONE)
    if raised.startswith("Odd"):
        expected = dict.fromkeys(expected, EXIT_RUN_FAILED)
    for method, code in {"nowhere": EXIT_DONE, **expected}.items():
        (tmp_path / "mine.py").write_text(PLUGINS.replace("METHOD", method).replace("RAISED", raised))
        flags = [*FLIGHT, *(flag for setting in SETTINGS for flag in ("--set", setting))]
        left, _, told = run("run", "--in-process", *flags)
        errors = [line for line in told.splitlines() if line.startswith("error: ")]
        assert (method, left, len(errors)) == (method, code, int(code != EXIT_DONE)), told
        assert "Traceback" not in told
        assert code != EXIT_BAD_INPUT or not (tmp_path / "runs").exists()
        shutil.rmtree(tmp_path / "runs", ignore_errors=True)
        assert code == EXIT_DONE or raised.partition("(")[0] in errors[0]


NOISY = """
import os
import threading
import time

import meanflock as mf

print("imported")
os.write(1, b"as native code does")


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
NOISY_FLIGHT = ("run", "--method", "noisy", "--uavs", "2", "--duration", "1", "--no-record", "--quiet")


@pytest.mark.processes
@pytest.mark.parametrize("command", [NOISY_FLIGHT, ("plugins",)], ids=["run", "list"])
def test_standard_output_is_json_alone(tmp_path: Path, command: tuple[str, ...]) -> None:
    (tmp_path / "noisy.py").write_text(NOISY)
    line = (sys.executable, "-m", "meanflock", *command, "--plugin", "noisy.py", "--json")
    done = ended(*line, cwd=tmp_path)
    assert (done.returncode, "imported" in done.stderr) == (0, True), done.stderr
    found = json.loads(done.stdout)
    assert found["ticks"] == 10 if command[0] == "run" else "noisy" in {entry["name"] for entry in found}
