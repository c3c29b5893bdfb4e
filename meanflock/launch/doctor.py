"""`meanflock doctor`: checks whether this machine can fly a scenario."""

import importlib.metadata
import logging
import os
import platform
import shutil
import socket
import subprocess
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Literal

import psutil

from meanflock import kernels
from meanflock.channel.outlook import outlooks, remedies
from meanflock.kernels import sources
from meanflock.launch.memory import LearnerMemory, learner_memory, pair_bytes, shortage
from meanflock.net.access import DEFAULT_ENDPOINT
from meanflock.results.disk import OF_RUN, room
from meanflock.swarm import logs
from meanflock.swarm.errors import needed
from meanflock.swarm.scenario import Scenario

THREADS = 8  # of a process of the swarm; measured: 7, and 11 in the world
PACKAGES = ("eclipse-zenoh", "numpy", "msgspec", "prometheus-client", "pyarrow", "click", "rich")
USES = {  # packages that no flight needs
    "rerun-sdk": "recordings and pictures",
    "matplotlib": "plots",
    "scipy": "comparisons",
    "cryptography": "certificates",
}
_INSTALL = "pip install 'meanflock[ground]'"
VIEWER_PORT = 9876
_BUS_PORT = int(DEFAULT_ENDPOINT.rpartition(":")[2])
GROUPS = Path("/sys/fs/cgroup")  # control groups, with the limits of a container
COMPOSE_MAJOR = 2
_ENGINE_S = 10.0

Verdict = Literal["ok", "warning", "fails"]


@dataclass(frozen=True)
class Finding:
    """Result of one check; `remedy` says what to do if it is not ok."""

    check: str
    verdict: Verdict
    found: str
    remedy: str = ""


def examine(scenario: Scenario, uavs_per_process: int, out: Path, tls: Path | None = None) -> list[Finding]:
    """Check everything that a run of a scenario needs."""
    uavs = scenario.uavs
    needed_memory = memory(uavs, -(-uavs // uavs_per_process), pair_bytes(scenario), learner_memory(scenario))
    return [
        _python(),
        *map(_package, (*PACKAGES, *USES)),
        compiled(),
        needed_memory,
        open_files(uavs, uavs_per_process),
        threads(uavs, uavs_per_process),
        _loopback(),
        _port("bus port", _BUS_PORT, "only in the way of processes started by hand: give them another with --endpoint"),
        _port("live viewer port", VIEWER_PORT, "end what listens there, or run without --view"),
        _writable(out),
        disk(scenario, out),
        *(models(scenario) if needed_memory.verdict == "ok" else []),  # they may be sent over N² links
        *engine(),
        *([] if tls is None else certificates(tls, uavs, uavs_per_process)),
    ]


def _python() -> Finding:
    return Finding("Python", "ok", f"{platform.python_version()} on {platform.machine()}, {os.cpu_count()} cores")


def _package(name: str) -> Finding:
    try:
        return Finding(name, "ok", importlib.metadata.version(name))
    except importlib.metadata.PackageNotFoundError:
        if name in USES:
            return Finding(name, "warning", "not installed", f"only needed for {USES[name]}: {_INSTALL}")
        return Finding(name, "fails", "not installed", _INSTALL)


def compiled() -> Finding:
    """Check whether the kernels are compiled."""
    if kernels.BACKEND == "compiled":
        return Finding("kernels", "ok", "compiled")
    if os.environ.get("MEANFLOCK_PURE") == "1":
        return Finding("kernels", "ok", "NumPy's, because of MEANFLOCK_PURE=1")
    if sources.built():
        found = "built from other sources than those that are here: NumPy's, 3 to 10 times slower"
        return Finding("kernels", "warning", found, "build them again: python -m pip install --no-deps -e .")
    return Finding(
        "kernels",
        "warning",
        "not compiled: NumPy's, 3 to 10 times slower",
        "install a C compiler and Python's headers, then meanflock again",
    )


def tell_if_slow() -> None:
    """Warn on standard error if the compiled kernels are missing."""
    finding = compiled()
    if finding.verdict != "ok":
        logs.note(f"kernels {finding.found}; {finding.remedy}", logging.WARNING)


def models(scenario: Scenario) -> list[Finding]:
    """Check whether the radio delivers the models of a scenario."""
    return [
        Finding(
            f"{one.message}s",
            "warning" if one.is_bad else "ok",
            str(one),
            remedies(scenario, one.message) if one.is_bad else "",
        )
        for one in outlooks(scenario)
    ]


def memory(uavs: int, processes: int, pair_bytes: int = 0, learner: LearnerMemory | None = None) -> Finding:
    """Check whether a run fits into memory; arguments as of `needed_mb`."""
    found, remedy = shortage(uavs, processes, pair_bytes, learner)
    return Finding("memory", "fails" if remedy else "ok", found, remedy)


def _number(path: Path) -> int | None:
    """Number in a file of the kernel; None without file or limit."""
    try:
        return int(path.read_text())
    except (OSError, ValueError):
        return None


def threads(uavs: int, uavs_per_process: int, groups: Path = GROUPS) -> Finding:
    """Check the limit of threads, which the kernel counts as processes."""
    import resource

    needed = THREADS * (-(-uavs // uavs_per_process) + 3)
    limits = []
    soft, _ = resource.getrlimit(resource.RLIMIT_NPROC)
    if soft != resource.RLIM_INFINITY and os.getuid() != 0:
        mine = os.getuid()
        running = sum(p.info["num_threads"] or 0 for p in psutil.process_iter(["uids", "num_threads"]) if _of(p, mine))
        limits.append((soft - running, f"ulimit -u {running + needed}"))
    for folder in (groups, groups / "pids"):
        most, now = _number(folder / "pids.max"), _number(folder / "pids.current")
        if most is not None and now is not None:
            limits.append((most - now, f"give this container a limit of {now + needed} processes"))
    if not limits:
        return Finding("threads", "ok", f"{needed} needed, no limit")
    left, remedy = min(limits)
    found = f"{needed} needed, {max(0, left)} left"
    return Finding("threads", "ok", found) if needed <= left else Finding("threads", "fails", found, remedy)


def _of(process: psutil.Process, uid: int) -> bool:
    uids = process.info["uids"]
    return uids is not None and uids.real == uid


def open_files(uavs: int, uavs_per_process: int) -> Finding:
    """Check the limit of open files of the launcher."""
    import resource

    needed = 64 + 8 * -(-uavs // uavs_per_process)
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    found = f"{needed} needed, limit {soft}"
    if soft != resource.RLIM_INFINITY and needed > soft:
        return Finding("open files", "fails", found, f"ulimit -n {needed}")
    return Finding("open files", "ok", found)


def _loopback() -> Finding:
    try:
        with socket.create_server(("127.0.0.1", 0)) as server:
            return Finding("loopback", "ok", f"can listen, for example on port {server.getsockname()[1]}")
    except OSError as error:
        return Finding("loopback", "fails", str(error), "bring the loopback interface up: ip link set lo up")


def _port(check: str, port: int, remedy: str) -> Finding:
    try:
        with socket.create_server(("127.0.0.1", port)):
            return Finding(check, "ok", f"{port} is free")
    except OSError as error:
        return Finding(check, "warning", f"{port}: {os.strerror(error.errno or 0)}", remedy)


def _existing(path: Path) -> Path:
    path = path.absolute()
    while not path.exists():
        path = path.parent
    return path


def _writable(out: Path) -> Finding:
    place = _existing(out)
    if os.access(place, os.W_OK | os.X_OK) and place.is_dir():
        return Finding("output folder", "ok", str(out))
    return Finding("output folder", "fails", f"{place} cannot be written", "name another with --out")


def disk(scenario: Scenario, out: Path, record: bool = True) -> Finding:
    """Check whether the run folder has room on its disk, if the flight takes as long as it may."""
    found, remedy = room(scenario, out, record, OF_RUN)
    return Finding("disk", "ok", found) if remedy is None else Finding("disk", "fails", found, remedy)


def certificates(folder: Path, uavs: int, uavs_per_process: int) -> list[Finding]:
    """Check that all certificates are there, readable, of one authority and valid."""
    with needed("--tls", "ground"):  # a library that most runs need not load
        from meanflock.launch import certs
    wanted = certs.names(uavs, uavs_per_process)
    found = [
        Finding(
            "certificate",
            "warning" if problem.remedy.startswith("chmod") else "fails",
            f"{problem.path}: {problem.reason}",
            problem.remedy,
        )
        for problem in certs.problems(folder, wanted)
    ]
    if found:
        return found
    end = certs.expires(folder, wanted)
    left = end - datetime.now(UTC)
    text = f"{len(wanted)} of one authority, valid until {end:%Y-%m-%d %H:%M} UTC"
    if left < timedelta(days=certs.SOON_DAYS):
        return [Finding("certificates", "warning", text, "make new ones soon: meanflock certs init DIR --uavs N")]
    return [Finding("certificates", "ok", text)]


def engine() -> list[Finding]:
    """Check the container client, its engine and its compose plugin."""
    if shutil.which("docker") is None:
        return [_engineless("not found", "install Docker Engine and its compose plugin")]
    code, output = _docker("version", "--format", "{{.Server.Version}}")
    if code:
        return [_engineless(*_unreachable(output)), _compose()]
    return [Finding("container engine", "ok", f"version {output}"), _compose()]


def _engineless(found: str, remedy: str) -> Finding:
    return Finding("container engine", "warning", found, f"only needed for containers: {remedy}")


def _unreachable(output: str) -> tuple[str, str]:
    """Finding and advice for an error of the client."""
    if "permission denied" in output.lower():
        return "you may not talk to it", "sudo usermod -aG docker $USER, then log in again"
    where = os.environ.get("DOCKER_HOST", "")
    if where:
        return f"no engine at DOCKER_HOST={where}", "start it there, or unset DOCKER_HOST"
    return f"does not run ({output.splitlines()[-1] if output else 'no answer'})", "sudo systemctl start docker"


def _compose() -> Finding:
    code, output = _docker("compose", "version", "--short")
    remedy = f"only needed for containers: install the compose plugin, version {COMPOSE_MAJOR} or newer"
    if code:
        return Finding("docker compose", "warning", "no such plugin", remedy)
    major = output.removeprefix("v").partition(".")[0]
    if not major.isdigit() or int(major) < COMPOSE_MAJOR:
        return Finding("docker compose", "warning", f"version {output}", remedy)
    return Finding("docker compose", "ok", f"version {output}")


def _docker(*arguments: str) -> tuple[int, str]:
    """Exit code and output of the client; a timeout counts as an error."""
    try:
        done = subprocess.run(["docker", *arguments], capture_output=True, text=True, timeout=_ENGINE_S)
    except subprocess.TimeoutExpired:
        return 1, f"no answer within {_ENGINE_S:.0f} s"
    except OSError as error:
        return 1, str(error)
    return done.returncode, (done.stdout if done.returncode == 0 else done.stderr).strip()
