"""An agent without the controller of the flight is refused when it joins."""

import json
import platform
import re
import signal
import subprocess
from pathlib import Path

import pytest

from meanflock.groundstation.launch.processes import free_endpoint
from meanflock.swarm import plugins
from meanflock.swarm.errors import EXIT_BAD_INPUT
from tests.integration.conftest import Spawn
from tests.polling import DEADLINE_S, until

pytestmark = pytest.mark.processes

ROOT = Path(__file__).parents[2]
SPRING = ("--plugin", str(ROOT / "examples" / "spring.py"))
HOST = re.escape(platform.node())
LACKING = rf"on host {HOST}: controller 'spring' is not installed here; install its package, or name its file: --plugin"


@pytest.fixture(autouse=True)
def named_on_the_command_line_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """What this environment has by variable, every process would have."""
    monkeypatch.setenv(plugins.FILES, "")


def ended(process: "subprocess.Popen[str]") -> tuple[int, str, str]:
    out, err = process.communicate(timeout=DEADLINE_S)
    return process.returncode, out, err


def refused(process: "subprocess.Popen[str]") -> None:
    status, _, err = ended(process)
    assert status == EXIT_BAD_INPUT, err
    assert re.search(LACKING, err)
    assert "Traceback" not in err


def test_in_mid_flight_it_is_refused_and_an_agent_that_has_it_rejoins(spawn: Spawn, tmp_path: Path) -> None:
    base = ("--endpoint", free_endpoint(), "--run", "lacking")
    station = spawn("meanflock.groundstation", *base, *SPRING, "--out", str(tmp_path), "--rerun", "")
    settings = ("uavs=2", "method=spring", "duration=100000", "stop=duration")
    flags = (flag for setting in settings for flag in ("--set", setting))
    world = spawn("meanflock.worldsim", *base, *SPRING, "--stations", "1", *flags)
    agents = [spawn("meanflock.agent", *base, *SPRING, "--uav", str(uav)) for uav in (0, 1)]

    def recorded(kind: str) -> list[str]:
        lines = "".join(path.read_text(encoding="utf-8") for path in tmp_path.glob("*/events.jsonl")).splitlines()
        events = [json.loads(line) for line in lines if line.endswith("}")]
        return [event["text"] for event in events if event["kind"] == kind]

    until(lambda: any(path.stat().st_size > 5_000 for path in tmp_path.glob("*/.telemetry")), "a flight")
    agents[1].kill()
    until(lambda: any("agent-1" in text for text in recorded("lost")), "a lost node")
    refused(spawn("meanflock.agent", *base, "--uav", "1"))
    until(lambda: any(re.search(LACKING, text) for text in recorded("lost")), "the host in an event of the flight")
    spawn("meanflock.agent", *base, *SPRING, "--uav", "1")
    until(lambda: recorded("rejoined"), "the UAV back in the flight")
    world.send_signal(signal.SIGINT)
    _, out, said = ended(world)
    summary = json.loads(out)
    assert summary["nodes_rejoined"] == 1, said
    assert summary["dropped_messages"] == {}
    ended(station)
