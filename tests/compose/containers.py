"""A swarm in containers, on whichever engine runs."""

import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from meanflock.launch import certs
from tests.commands import ended
from tests.faults.by_hand import Recorded
from tests.polling import until

REPOSITORY = Path(__file__).parents[2]
UAVS = 5
USER = os.getuid() or 1000  # nobody's containers are root
FLYING = ("worldsim", "leader", "agent", "groundstation")  # and `completed`, whose start waits for the end of a flight
# What a busy machine needs: no test waits for one of these to pass.
PATIENT = {"MEANFLOCK_WAIT": "150", "MEANFLOCK_BARRIER": "60", "MEANFLOCK_LEASE": "30"}
FLIGHT_S = 300.0  # the longest that a flight may take, start and end included


def docker(*arguments: str, check: bool = True, env: dict[str, str] | None = None) -> str:
    done = ended("docker", *arguments, cwd=REPOSITORY, env=env)
    assert not check or done.returncode == 0, f"docker {' '.join(arguments)}: {done.stderr}"
    return done.stdout


def docker_fails(code: int, *arguments: str) -> str:
    done = ended("docker", *arguments)
    assert done.returncode == code, f"{done.stdout}\n{done.stderr}"
    return done.stderr


def engine_runs() -> bool:
    try:
        return subprocess.run(["docker", "info"], capture_output=True, timeout=20).returncode == 0
    except (OSError, subprocess.TimeoutExpired):
        return False


MARKS = [
    pytest.mark.processes,
    pytest.mark.timeout(600),
    pytest.mark.skipif(not engine_runs() and not os.environ.get("REQUIRE_ENGINE"), reason="no container engine runs"),
]


class Compose(Recorded):
    def __init__(self, name: str, out: Path) -> None:
        super().__init__(out)
        self.name = name
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
            **PATIENT,
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

    def inspect(self, container: str, part: str) -> dict[str, Any]:
        return json.loads(docker("inspect", "-f", f"{{{{json .{part}}}}}", container))

    def state(self, container: str) -> dict[str, Any]:
        return self.inspect(container, "State")

    def ended(self, container: str, code: int = 0) -> None:
        """Waits for the end of a container, which must have that exit code. A test that failed prints all logs."""
        until(lambda: self.state(container)["Status"] == "exited", f"{container} to end", FLIGHT_S)
        found = self.state(container)["ExitCode"]
        assert found == code, f"{container} ended with {found} instead of {code}"

    def finished(self) -> dict[str, Any]:
        """Waits for all containers to end well; the summary."""
        for container in self.containers():
            self.ended(container)
        return self.summary()

    def summary(self) -> dict[str, Any]:
        return json.loads((self.folder / "summary.json").read_text())


# This controller never diverges, so only the test loses UAVs.
ENDLESS = "seed=7 duration=100000 stop=duration method=fed-lspi"
SHORT = ["seed=7", "duration=30", "federation.period=50"]


class Clone(Recorded):
    """A folder as git leaves it, without `runs`, in which somebody types `docker compose up` and nothing else."""

    def __init__(self, folder: Path, name: str) -> None:
        super().__init__(folder / "runs")
        folder.mkdir()
        shutil.copy(REPOSITORY / "docker-compose.yml", folder)
        shutil.copytree(REPOSITORY / "scenarios", folder / "scenarios")
        self._clone, self.name = folder, name

    def up(self, settings: str) -> "subprocess.Popen[str]":
        """What is typed, for a small swarm; it ends when all containers have."""
        env = {name: value for name, value in os.environ.items() if not name.startswith("MEANFLOCK_")}
        env |= {"MEANFLOCK_UAVS": "2", "MEANFLOCK_SET": settings, "MEANFLOCK_RERUN_PORT": "0", **PATIENT}
        line = ["docker", "compose", "-p", self.name, "up"]
        pipe = subprocess.PIPE
        return subprocess.Popen(line, cwd=self._clone, env=env, stdout=pipe, stderr=subprocess.STDOUT, text=True)

    def down(self) -> None:
        line = ["docker", "compose", "-p", self.name, "down", "-v", "--timeout", "2"]
        ended(*line, cwd=self._clone)
