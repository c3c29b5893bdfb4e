"""The containers on a real engine: the same trajectory, and a flight that goes on whatever happens to a container.

Run by `make test-compose`, which builds the images first. Skipped where no engine runs.
"""

import json
import os
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from prometheus_client.parser import text_string_to_metric_families

from groundstation.engine import Engine
from swarm import scenario

REPOSITORY = Path(__file__).parents[2]
DEADLINE_S = 180.0
UAVS = 5


def docker(*arguments: str, check: bool = True, env: dict[str, str] | None = None) -> str:
    done = subprocess.run(
        ["docker", *arguments], cwd=REPOSITORY, env=env, capture_output=True, text=True, timeout=DEADLINE_S
    )
    assert not check or done.returncode == 0, f"docker {' '.join(arguments)}: {done.stderr}"
    return done.stdout


def engine_runs() -> bool:
    try:
        return subprocess.run(["docker", "info"], capture_output=True, timeout=20).returncode == 0
    except (OSError, subprocess.TimeoutExpired):
        return False


pytestmark = [
    pytest.mark.timeout(420),
    pytest.mark.skipif(not engine_runs() and not os.environ.get("REQUIRE_ENGINE"), reason="no container engine runs"),
]


def until(true: Callable[[], Any], what: str) -> Any:
    end = time.monotonic() + DEADLINE_S
    while time.monotonic() < end:
        if result := true():
            return result
        time.sleep(0.2)
    raise AssertionError(f"not within {DEADLINE_S:.0f} s: {what}")


class Compose:
    """One `docker compose` project of this test."""

    def __init__(self, name: str, out: Path) -> None:
        self.name, self.out = name, out
        self._env: dict[str, str] = {}

    def up(self, settings: str, **variables: str) -> None:
        self._env = {
            **os.environ,
            "MEANFLOCK_UAVS": str(UAVS),
            "MEANFLOCK_RUN": self.name,
            "MEANFLOCK_SET": settings,
            "MEANFLOCK_OUT_DIR": str(self.out),
            "MEANFLOCK_UID": str(os.getuid()),
            "MEANFLOCK_GID": str(os.getgid()),
            "MEANFLOCK_RERUN_PORT": "0",
            **variables,
        }
        self("up", "-d", "--no-build", "--pull", "never")

    def __call__(self, *arguments: str, check: bool = True) -> str:
        return docker("compose", "-p", self.name, *arguments, check=check, env=self._env)

    def container(self, service: str, index: int = 1) -> str:
        return f"{self.name}-{service}-{index}"

    def state(self, container: str) -> dict[str, Any]:
        return json.loads(docker("inspect", "-f", "{{json .State}}", container))

    def flying(self) -> None:
        """Waits for telemetry on the mounted volume."""
        until(lambda: [p for p in self.out.glob("*/.timeseries.arrow") if p.stat().st_size > 20_000], "telemetry")

    def finished(self) -> dict[str, Any]:
        """Waits for world and ground station to end well; the summary."""
        for service in ("worldsim", "groundstation"):
            container = self.container(service)
            until(lambda c=container: self.state(c)["Status"] == "exited", f"{service} to end")
            assert self.state(container)["ExitCode"] == 0, docker("logs", container)
        (folder,) = self.out.iterdir()
        return json.loads((folder / "summary.json").read_text())

    def events(self, kind: str) -> list[dict[str, Any]]:
        lines = [line for path in self.out.glob("*/events.jsonl") for line in path.read_text().splitlines()]
        return [event for event in map(json.loads, lines) if event["kind"] == kind]


@pytest.fixture
def compose(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Compose]:
    out = tmp_path / "runs"
    out.mkdir()
    project = Compose(f"meanflock-test-{os.getpid()}", out)
    yield project
    if request.session.testsfailed:
        print(project("logs", "--tail", "30", check=False))
    project("down", "-v", "--timeout", "2", check=False)
    shutil.rmtree(out, ignore_errors=True)


LONG = "seed=7 duration=300 stop=duration"
SLOWLY = {"MEANFLOCK_REALTIME": "15", "MEANFLOCK_BARRIER": "2"}


def test_containers_fly_the_trajectory_of_one_process_and_leave_the_run_folder(compose: Compose) -> None:
    settings = ["seed=7", "duration=30", "federation.period=50"]
    compose.up(" ".join(settings))
    summary = compose.finished()
    alone = Engine(scenario.load(None, settings, uavs=UAVS), "alone")
    for _ in alone.fly():
        pass
    assert summary["trajectory_sha256"] == alone.world.flight.trajectory_sha256
    (folder,) = compose.out.iterdir()
    assert {"scenario.toml", "summary.json", "timeseries.parquet", "events.jsonl", "recording.rrd"} == {
        path.name for path in folder.iterdir()
    }
    for index in range(1, UAVS + 1):
        agent = compose.container("agent", index)
        until(lambda a=agent: compose.state(a)["Status"] == "exited", "agents to go home")
        assert compose.state(agent)["ExitCode"] == 0


def test_a_killed_agent_is_lost_and_the_flight_goes_on(compose: Compose) -> None:
    compose.up(LONG, **SLOWLY)
    compose.flying()
    docker("kill", compose.container("agent", 2))
    until(lambda: compose.events("lost"), "the loss")
    summary = compose.finished()
    assert summary["lost"] == 1
    assert summary["ticks"] == 3000


def test_a_paused_agent_stalls_nobody_longer_than_the_barrier(compose: Compose) -> None:
    compose.up(LONG, MEANFLOCK_BARRIER="2")
    compose.flying()
    docker("pause", compose.container("agent", 1))
    until(lambda: compose.events("lost"), "the loss")
    summary = compose.finished()
    docker("unpause", compose.container("agent", 1))
    assert summary["lost"] == 1
    assert summary["ticks"] == 3000


def test_an_agent_cut_off_beyond_the_lease_is_lost(compose: Compose) -> None:
    compose.up(LONG, MEANFLOCK_BARRIER="2")
    compose.flying()
    docker("network", "disconnect", f"{compose.name}_swarm", compose.container("agent", 3))
    until(lambda: compose.events("lost"), "the loss")
    docker("network", "connect", "--alias", "agent", f"{compose.name}_swarm", compose.container("agent", 3))
    summary = compose.finished()
    assert summary["ticks"] == 3000
    assert summary["arrived"] + summary["lost"] >= 1


def test_agents_beyond_the_swarm_are_refused_and_fewer_are_a_loss(compose: Compose) -> None:
    compose.up(LONG, **SLOWLY)
    compose.flying()
    compose("up", "-d", "--no-build", "--pull", "never", "--no-recreate", "--scale", f"agent={UAVS + 1}")
    extra = compose.container("agent", UAVS + 1)
    until(lambda: compose.state(extra)["Status"] == "exited", "the refusal")
    assert compose.state(extra)["ExitCode"] == 1
    assert "refused" in subprocess.run(["docker", "logs", extra], capture_output=True, text=True).stderr
    assert compose.events("lost") == []
    compose("up", "-d", "--no-build", "--pull", "never", "--no-recreate", "--scale", f"agent={UAVS - 1}")
    until(lambda: compose.events("lost"), "the loss")
    assert compose.finished()["ticks"] == 3000


def test_25_containers_keep_to_the_wall_clock_and_can_be_read_meanwhile(compose: Compose) -> None:
    flags = {"MEANFLOCK_UAVS": "25", "MEANFLOCK_REALTIME": "1", "MEANFLOCK_METRICS": "0.0.0.0:9464"}
    compose.up("seed=7 duration=20 stop=duration", **flags, MEANFLOCK_LOG_FORMAT="json")
    read = "import urllib.request as u; print(u.urlopen('http://127.0.0.1:9464/metrics').read().decode())"

    def metrics() -> dict[tuple[str, frozenset[tuple[str, str]]], float]:
        text = compose("exec", "-T", "worldsim", "python", "-c", read, check=False)
        families = text_string_to_metric_families(text)
        return {(s.name, frozenset(s.labels.items())): s.value for family in families for s in family.samples}

    until(lambda: metrics().get(("meanflock_ticks_total", frozenset()), 0) > 0, "the first tick")
    seen = metrics()
    assert seen["meanflock_nodes_alive", frozenset({("role", "agent")})] == 25
    summary = compose.finished()
    kept = summary["realtime"]
    print(f"real_time_factor {summary['real_time_factor']:.4f}, {summary['held_commands']} held, {kept}")
    assert summary["ticks"] == 200
    assert summary["lost"] == 0
    assert summary["real_time_factor"] == pytest.approx(1.0, rel=0.05)
    assert summary["wall_time_s"] >= 20.0
    assert 0 <= kept["deadline_misses"] <= summary["held_commands"] <= 25 * 200
    assert 0.0 <= kept["tick_start_jitter_ms"]["mean"] <= kept["tick_start_jitter_ms"]["max"]
    said = subprocess.run(["docker", "logs", compose.container("worldsim")], capture_output=True, text=True).stderr
    assert {(line["run"], line["node"]) for line in map(json.loads, said.splitlines())} == {(compose.name, "world")}
