"""The containers on a real engine: the same trajectory, and a flight that goes on whatever happens to a container.

Run by `make test-compose`, which builds the images first. Skipped where no engine runs.
"""

import fcntl
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
from prometheus_client.parser import text_string_to_metric_families

from meanflock.groundstation import certs
from tests.polling import DEADLINE_S, until

REPOSITORY = Path(__file__).parents[2]
UAVS = 5
USER = os.getuid() or 1000  # nobody's containers are root
FLYING = ("worldsim", "leader", "agent", "groundstation")  # and `completed`, whose start waits for the end of a flight


def docker(*arguments: str, check: bool = True, env: dict[str, str] | None = None) -> str:
    done = subprocess.run(
        ["docker", *arguments], cwd=REPOSITORY, env=env, capture_output=True, text=True, timeout=DEADLINE_S
    )
    assert not check or done.returncode == 0, f"docker {' '.join(arguments)}: {done.stderr}"
    return done.stdout


def docker_fails(*arguments: str) -> str:
    """What docker says where it must fail."""
    done = subprocess.run(["docker", *arguments], capture_output=True, text=True, timeout=DEADLINE_S)
    assert done.returncode != 0, done.stdout
    return done.stderr


def engine_runs() -> bool:
    try:
        return subprocess.run(["docker", "info"], capture_output=True, timeout=20).returncode == 0
    except (OSError, subprocess.TimeoutExpired):
        return False


pytestmark = [
    pytest.mark.processes,
    pytest.mark.timeout(420),
    pytest.mark.skipif(not engine_runs() and not os.environ.get("REQUIRE_ENGINE"), reason="no container engine runs"),
]


class Compose:
    """One `docker compose` project of this test."""

    def __init__(self, name: str, out: Path) -> None:
        self.name, self.out = name, out
        self._env: dict[str, str] = {}
        self._files: tuple[str, ...] = ()

    def secure(self, folder: Path) -> None:
        """From now on with the certificates in `folder`."""
        self._files = ("-f", "docker-compose.yml", "-f", str(folder / certs.COMPOSE), "--profile", "secure")

    def up(self, settings: str, *services: str, **variables: str) -> None:
        self._env = {
            **os.environ,
            "MEANFLOCK_UAVS": str(UAVS),
            "MEANFLOCK_RUN": self.name,
            "MEANFLOCK_SET": settings,
            "MEANFLOCK_OUT_DIR": str(self.out),
            "MEANFLOCK_UID": str(USER),
            "MEANFLOCK_GID": str(os.getgid() or USER),
            "MEANFLOCK_RERUN_PORT": "0",
            **variables,
        }
        self("up", "-d", "--no-build", "--pull", "never", *(services or FLYING))

    def __call__(self, *arguments: str, check: bool = True) -> str:
        return docker("compose", *self._files, "-p", self.name, *arguments, check=check, env=self._env)

    def container(self, service: str, index: int = 1) -> str:
        return f"{self.name}-{service}-{index}"

    def containers(self) -> dict[str, str]:
        """Every container there is, and its service; but for `runs`, which has done its work."""
        rows = self("ps", "-a", "--format", "{{.Name}} {{.Service}}").splitlines()
        return {name: service for name, service in map(str.split, rows) if service != "runs"}

    def inspect(self, container: str, what: str) -> dict[str, Any]:
        return json.loads(docker("inspect", "-f", f"{{{{json .{what}}}}}", container))

    def state(self, container: str) -> dict[str, Any]:
        return self.inspect(container, "State")

    def ended(self, container: str) -> int:
        """Waits for a container to end by itself; its exit code."""
        until(lambda: self.state(container)["Status"] == "exited", f"{container} to end")
        return int(self.state(container)["ExitCode"])

    def written(self) -> int:
        """Bytes of telemetry on the mounted volume."""
        return sum(path.stat().st_size for path in self.out.glob("*/.telemetry"))

    def flying(self) -> None:
        """Waits for telemetry."""
        until(lambda: self.written() > 20_000, "telemetry")

    def finished(self) -> dict[str, Any]:
        """Waits for world and ground station to end well; the summary."""
        for service in ("worldsim", "groundstation"):
            assert self.ended(self.container(service)) == 0, docker("logs", self.container(service))
        return self.summary()

    def summary(self) -> dict[str, Any]:
        (folder,) = self.out.iterdir()
        return json.loads((folder / "summary.json").read_text())

    def events(self, kind: str) -> list[dict[str, Any]]:
        lines = [line for path in self.out.glob("*/events.jsonl") for line in path.read_text().splitlines()]
        return [event for event in map(json.loads, lines) if event["kind"] == kind]


@pytest.fixture(autouse=True)
def engine(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The engine is shared by the tests of all workers, but for one that is marked `alone`."""
    with (tmp_path_factory.getbasetemp().parent / "engine.lock").open("w") as held:
        fcntl.flock(held, fcntl.LOCK_EX if request.node.get_closest_marker("alone") else fcntl.LOCK_SH)
        yield


@pytest.fixture
def compose(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Compose]:
    out = tmp_path / "runs"
    out.mkdir()
    os.chown(out, USER, os.getgid() or USER)
    project = Compose(f"meanflock-test-{os.getpid()}", out)
    yield project
    if request.session.testsfailed:
        print(project("logs", "--tail", "30", check=False))
    project("down", "-v", "--remove-orphans", "--timeout", "2", check=False)
    shutil.rmtree(out, ignore_errors=True)


LONG = "seed=7 duration=400 stop=duration"
# Whose agent comes back after thousands of ticks is far off and fast. There the paper's learners may diverge at once;
# these two never do, so that who is lost at the end is lost by what the test did.
ENDLESS = "seed=7 duration=100000 stop=duration method=fed-lspi"
ENDLESS_ALONE = "seed=7 duration=100000 stop=duration method=plan"  # without a leader


SHORT = ["seed=7", "duration=30", "federation.period=50"]


def flown_alone(out: Path, *arguments: str) -> str:
    """The trajectory of `SHORT` in one process, with the arithmetic the containers choose, whatever is set here."""
    line = [sys.executable, "-m", "meanflock", "run", "--in-process", "--no-record", "--json", "--quiet"]
    line += [word for setting in (*SHORT, f"uavs={UAVS}") for word in ("--set", setting)]
    env = {name: value for name, value in os.environ.items() if not name.startswith("OPENBLAS")}
    done = subprocess.run(
        [*line, *arguments, "--out", str(out)], env=env, capture_output=True, text=True, timeout=60, cwd=REPOSITORY
    )
    assert done.returncode == 0, done.stderr
    return str(json.loads(done.stdout)["trajectory_sha256"])


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> str:
    return flown_alone(tmp_path_factory.mktemp("alone"))


def test_containers_fly_the_trajectory_of_one_process_and_leave_the_run_folder(compose: Compose, alone: str) -> None:
    compose.up(" ".join(SHORT))
    summary = compose.finished()
    assert summary["trajectory_sha256"] == alone
    (folder,) = compose.out.iterdir()
    assert {"scenario.toml", "summary.json", "timeseries.parquet", "events.jsonl", "recording.rrd"} == {
        path.name for path in folder.iterdir()
    }
    for index in range(1, UAVS + 1):
        assert compose.ended(compose.container("agent", index)) == 0


def test_a_controller_in_a_mounted_file_flies_in_containers_as_in_one_process(compose: Compose, tmp_path: Path) -> None:
    compose.up(" ".join([*SHORT, "method=spring"]), MEANFLOCK_PLUGINS="/plugins/spring.py")
    summary = compose.finished()
    expected = flown_alone(tmp_path / "alone", "--plugin", "examples/spring.py", "--method", "spring")
    assert summary["trajectory_sha256"] == expected
    assert (summary["method"], summary["lost"]) == ("spring", 0)
    for index in range(1, UAVS + 1):
        assert compose.ended(compose.container("agent", index)) == 0


def test_under_tls_every_container_has_its_own_key_and_a_foreign_certificate_is_kept_out_and_counted(
    compose: Compose, alone: str, tmp_path: Path
) -> None:
    good, foreign = tmp_path / "certs", tmp_path / "foreign"
    certs.init(good, UAVS)
    certs.init(foreign, UAVS)
    compose.secure(good)
    agents = [f"agent-{uav}" for uav in range(UAVS)]
    compose.up(" ".join(SHORT), "worldsim", "leader", "groundstation", *agents[:-1])  # the flight waits for the last
    own = {"worldsim": "world", "groundstation": "station"}
    assert set(compose.containers().values()) == {"worldsim", "leader", "groundstation", *agents[:-1]}
    for container, service in compose.containers().items():
        name = own.get(service, service)
        assert docker("exec", container, "ls", "/certs").split() == sorted(["ca.pem", f"{name}.key", f"{name}.pem"])
    mounts = {"ca.pem": good, f"{agents[-1]}.pem": foreign, f"{agents[-1]}.key": foreign}
    line = ["run", "--rm", "--network", f"{compose.name}_swarm", "--user", str(USER)]
    line += [word for file, folder in mounts.items() for word in ("-v", f"{folder / file}:/certs/{file}:ro")]
    line += ["meanflock-agent:local", "meanflock.agent", "--endpoint", "tls/worldsim:7447", "--run", compose.name]
    line += ["--tls", "/certs", "--wait", "3"]
    intruder = subprocess.run(["docker", *line], capture_output=True, text=True, timeout=DEADLINE_S)
    assert intruder.returncode == 1, intruder.stderr
    assert f"refuses /certs/{agents[-1]}.pem" in intruder.stderr
    compose.up(" ".join(SHORT), agents[-1])
    summary = compose.finished()
    assert summary["trajectory_sha256"] == alone
    assert summary["dropped_messages"].keys() == {"refused-link"}
    assert "UnknownIssuer" in compose("logs", "worldsim")
    for agent in ("leader", *agents):
        assert compose.ended(compose.container(agent)) == 0


def test_containers_are_healthy_can_do_no_more_than_they_must_and_end_when_they_are_asked(compose: Compose) -> None:
    compose.up(ENDLESS)
    compose.flying()
    for container, service in compose.containers().items():
        until(lambda c=container: compose.state(c)["Health"]["Status"] == "healthy", f"{container} to be healthy")
        assert int(docker("exec", container, "id", "-u")) == USER
        assert "Read-only" in docker_fails("exec", container, "touch", "/app/new")
        docker("exec", container, "touch", "/tmp/new")
        powers = docker("exec", container, "grep", "-E", "Cap(Inh|Prm|Eff|Bnd)|NoNewPrivs", "/proc/self/status")
        assert [line.split()[1].lstrip("0") for line in powers.splitlines()] == ["", "", "", "", "1"]
        limits = compose.inspect(container, "HostConfig")
        memory_mb = {"worldsim": 512, "groundstation": 1024}.get(service, 256)
        assert (limits["Memory"], limits["Privileged"]) == (memory_mb * 2**20, False)
        assert limits["NanoCpus"] > 0
        assert limits["PidsLimit"] > 0
        assert compose.inspect(container, "Config")["StopSignal"] == "SIGINT"
    docker("stop", compose.container("agent", 2))
    assert compose.state(compose.container("agent", 2))["ExitCode"] == 0  # 137: had to be killed
    until(lambda: compose.events("lost"), "the loss")
    docker("stop", compose.container("worldsim"))
    for container, service in compose.containers().items():
        assert compose.ended(container) == int(service == "worldsim"), docker("logs", container)  # 1: interrupted
    assert compose.summary()["lost"] == 1


def test_a_killed_agent_is_lost_and_the_flight_goes_on(compose: Compose) -> None:
    compose.up(ENDLESS)
    compose.flying()
    docker("kill", compose.container("agent", 2))
    losses = until(lambda: compose.events("lost"), "the loss")
    assert len(losses) == 1, losses
    written = compose.written()
    until(lambda: compose.written() > written, "the flight to go on")
    docker("stop", compose.container("worldsim"))
    assert compose.ended(compose.container("groundstation")) == 0
    summary = compose.summary()
    assert (summary["nodes_lost"], summary["lost"]) == (1, 1)
    assert summary["ticks"] > losses[0]["tick"]


def test_a_paused_agent_stalls_nobody_longer_than_the_barrier(compose: Compose) -> None:
    compose.up(LONG, MEANFLOCK_BARRIER="2")
    compose.flying()
    docker("pause", compose.container("agent", 1))
    until(lambda: compose.events("lost"), "the loss")
    summary = compose.finished()
    docker("unpause", compose.container("agent", 1))
    assert summary["lost"] == 1
    assert summary["ticks"] == 4000


def test_an_agent_cut_off_beyond_the_lease_is_lost_and_comes_back_when_it_can(compose: Compose) -> None:
    compose.up(ENDLESS_ALONE)
    compose.flying()
    agent, network = compose.container("agent", 3), f"{compose.name}_swarm"
    docker("network", "disconnect", network, agent)
    until(lambda: compose.events("lost"), "the loss")
    until(lambda: "lost the session" in compose("logs", "agent"), "the agent to miss the world")
    docker("network", "connect", "--alias", "agent", network, agent)

    def uavs(kind: str) -> list[int]:
        return sorted(uav for event in compose.events(kind) for uav in event["uavs"])

    # The router may stand still while it closes the dead link; who is taken for lost meanwhile comes back as well.
    until(lambda: uavs("rejoined") == uavs("lost"), "the agent to come back")
    written = compose.written()
    until(lambda: compose.written() > written + 20_000, "the flight to go on")
    docker("stop", compose.container("worldsim"))
    assert compose.ended(compose.container("groundstation")) == 0
    assert compose.ended(agent) == 0
    summary = compose.summary()
    assert summary["lost"] == 0
    assert summary["nodes_lost"] == summary["nodes_rejoined"] >= 1


def test_an_agent_beyond_the_swarm_stands_by_for_one_that_is_lost_and_fewer_are_a_loss(compose: Compose) -> None:
    compose.up(ENDLESS)
    compose.flying()

    def scale(agents: int) -> None:
        compose("up", "-d", "--no-build", "--pull", "never", "--no-recreate", "--scale", f"agent={agents}", "agent")

    scale(UAVS + 1)
    assert compose.events("lost") == []
    docker("rm", "--force", compose.container("agent", 2))
    until(lambda: compose.events("rejoined"), "the one beyond to take over")
    assert compose.state(compose.container("agent", UAVS + 1))["Running"]
    scale(UAVS - 1)
    until(lambda: len(compose.events("lost")) == 2, "the loss")
    docker("stop", compose.container("worldsim"))
    assert compose.ended(compose.container("groundstation")) == 0
    assert compose.summary()["lost"] == 1


class Clone:
    """A folder as git leaves it, without `runs`, in which somebody types `docker compose up` and nothing else."""

    def __init__(self, folder: Path, name: str) -> None:
        folder.mkdir()
        shutil.copy(REPOSITORY / "docker-compose.yml", folder)
        shutil.copytree(REPOSITORY / "scenarios", folder / "scenarios")
        self.runs, self._folder, self.name = folder / "runs", folder, name

    def up(self, settings: str) -> "subprocess.Popen[str]":
        """What is typed, for a small swarm; it ends when all containers have."""
        env = {name: value for name, value in os.environ.items() if not name.startswith("MEANFLOCK_")}
        env |= {"MEANFLOCK_UAVS": "2", "MEANFLOCK_SET": settings, "MEANFLOCK_RERUN_PORT": "0"}
        line = ["docker", "compose", "-p", self.name, "up"]
        pipe = subprocess.PIPE
        return subprocess.Popen(line, cwd=self._folder, env=env, stdout=pipe, stderr=subprocess.STDOUT, text=True)

    def written(self) -> int:
        """Bytes of telemetry in `runs`."""
        return sum(path.stat().st_size for path in self.runs.glob("*/.telemetry"))

    def down(self) -> None:
        line = ["docker", "compose", "-p", self.name, "down", "-v", "--timeout", "2"]
        subprocess.run(line, cwd=self._folder, capture_output=True, timeout=DEADLINE_S, check=False)


@pytest.fixture
def clone(tmp_path: Path) -> Iterator[Clone]:
    fresh = Clone(tmp_path / "meanflock", f"meanflock-clone-{os.getpid()}")
    yield fresh
    fresh.down()
    shutil.rmtree(fresh.runs, ignore_errors=True)


def test_plain_compose_up_in_a_fresh_clone_flies_and_ends_well(clone: Clone) -> None:
    up = clone.up("seed=7 duration=20")
    said, _ = up.communicate(timeout=DEADLINE_S)
    assert up.returncode == 0, said
    (folder,) = clone.runs.iterdir()
    assert json.loads((folder / "summary.json").read_text())["ticks"] == 200
    assert folder.stat().st_uid == 1000


def test_plain_compose_up_fails_where_the_ground_station_cannot_write(clone: Clone) -> None:
    clone.runs.mkdir(mode=0o555)
    up = clone.up("seed=7 duration=20")
    said, _ = up.communicate(timeout=DEADLINE_S)
    assert up.returncode == 1, said
    assert "--out /runs: Permission denied" in said
    assert 'service "groundstation" didn\'t complete successfully: exit 2' in said


def test_plain_compose_up_fails_when_the_ground_station_dies_and_again_goes_on_in_its_folder(clone: Clone) -> None:
    for killed in (True, False):
        written = clone.written()
        up = clone.up("seed=7 duration=100000 stop=duration")
        until(lambda written=written: clone.written() > written + 20_000, "telemetry")
        if killed:
            docker("kill", f"{clone.name}-groundstation-1")
        else:
            docker("stop", f"{clone.name}-worldsim-1")
        said, _ = up.communicate(timeout=DEADLINE_S)
        assert up.returncode == int(killed), said
        assert ("didn't complete successfully: exit 137" in said) == killed
    (folder,) = clone.runs.iterdir()
    ticks = pq.read_table(folder / "timeseries.parquet")["tick"].to_pylist()
    assert ticks == list(range(json.loads((folder / "summary.json").read_text())["ticks"] + 1))


def test_a_restarted_ground_station_goes_on_in_its_folder(compose: Compose) -> None:
    compose.up(ENDLESS)
    compose.flying()
    for end in ("stop", "kill"):
        docker(end, compose.container("groundstation"))
        written = compose.written()  # 0 where it could complete its folder
        docker("start", compose.container("groundstation"))
        until(lambda written=written: compose.written() > written + 20_000, "another station to record")
    docker("stop", compose.container("worldsim"))
    assert compose.ended(compose.container("groundstation")) == 0
    (folder,) = compose.out.iterdir()
    assert pq.read_table(folder / "timeseries.parquet").num_rows == compose.summary()["ticks"] + 1


@pytest.mark.alone
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
