"""An agent in nothing but `zenoh`, `msgpack` and `struct`, as docs/wire.md says, flies among ours, to the same bits."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from meanflock.groundstation.launch.engine import Engine
from meanflock.groundstation.launch.processes import free_endpoint
from meanflock.swarm import plugins
from meanflock.swarm.scenario import load
from tests.integration.conftest import Spawn
from tests.polling import DEADLINE_S

EXAMPLES = Path(__file__).parents[2] / "examples"
AGENT, SPRING = EXAMPLES / "foreign_agent.py", EXAMPLES / "spring.py"
SETTINGS = ("method=spring", "uavs=3", "seed=5", "duration=30", 'stop="duration"', "radio.target_snr_db=77")
FOREIGN = 1  # the UAV that is not flown by us

pytestmark = pytest.mark.processes


def test_an_agent_of_another_language_flies_among_ours_to_the_same_bits(spawn: Spawn, monkeypatch) -> None:
    modules = set(re.findall(r"^(?:import|from) (\w+)", AGENT.read_text(encoding="utf-8"), flags=re.M))
    assert modules <= sys.stdlib_module_names | {"msgpack", "zenoh"}
    endpoint = free_endpoint()
    monkeypatch.setenv(plugins.FILES, str(SPRING))
    base = ("--run", "foreign", "--endpoint", endpoint, "--wait", str(int(DEADLINE_S)))
    world = spawn("worldsim", *base, *(flag for setting in SETTINGS for flag in ("--set", setting)))
    ours = [spawn("agent", *base, "--uav", str(uav)) for uav in range(3) if uav != FOREIGN]
    line = [sys.executable, "-I", str(AGENT), "foreign", endpoint, str(FOREIGN)]
    foreign = subprocess.run(line, capture_output=True, text=True, timeout=DEADLINE_S, check=False)
    assert foreign.stdout.strip() == "finished 299", foreign.stderr
    out, err = world.communicate(timeout=DEADLINE_S)
    assert world.returncode == 0, err
    summary = json.loads(out)
    assert [process.wait(DEADLINE_S) for process in ours] == [0, 0]
    assert (summary["lost"], summary["nodes_lost"], summary["dropped_messages"]) == (0, 0, {})

    plugins.load_file(SPRING)
    alone = Engine(load(None, SETTINGS), "foreign").complete()
    assert summary["trajectory_sha256"] == alone["trajectory_sha256"]
    assert summary["payload_bits"] == alone["payload_bits"]
    assert alone["radio"]["traffic"]["state"]["sent"] == 300 * 3 * 2
    assert alone["radio"]["traffic"]["state"]["outages"] > 0
