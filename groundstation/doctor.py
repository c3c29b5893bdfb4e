"""`meanflock doctor`: what this machine has, and what would fail before it fails."""

import importlib.metadata
import os
import platform
import shutil
import socket
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Literal

from groundstation.memory import MEGABYTE, available_mb, needed_mb

PACKAGES = ("eclipse-zenoh", "numpy", "msgspec", "scipy", "pyarrow", "rerun-sdk", "click", "rich", "cryptography")
VIEWER_PORT = 9876
_ROWS = 25  # UAVs in a process, where one each is too many

Verdict = Literal["ok", "warning", "fails"]


@dataclass(frozen=True)
class Finding:
    """One thing looked at; `mend` says what to do where it is not ok."""

    what: str
    verdict: Verdict
    found: str
    mend: str = ""


def examine(uavs: int, uavs_per_process: int, out: Path, tls: Path | None = None) -> list[Finding]:
    """Looks at everything a run of that size would need."""
    return [
        _python(),
        *map(_package, PACKAGES),
        memory(uavs, -(-uavs // uavs_per_process)),
        open_files(uavs, uavs_per_process),
        _loopback(),
        _viewer_port(),
        _writable(out),
        _disk(out),
        _docker(),
        *([] if tls is None else certificates(tls, uavs, uavs_per_process)),
    ]


def _python() -> Finding:
    return Finding("Python", "ok", f"{platform.python_version()} on {platform.machine()}, {os.cpu_count()} cores")


def _package(name: str) -> Finding:
    try:
        return Finding(name, "ok", importlib.metadata.version(name))
    except importlib.metadata.PackageNotFoundError:
        return Finding(name, "fails", "not installed", "make install")


def memory(uavs: int, processes: int, keeps_states: bool = False) -> Finding:
    """Whether such a run fits into memory; `processes`: of agents, 0 for everything in one."""
    needed, (available, what) = needed_mb(uavs, processes, keeps_states), available_mb()
    where = f"{processes} processes" if processes else "one process"
    found = f"{needed} MB for {uavs} UAVs in {where}, {available} MB {what}"
    if needed <= available:
        return Finding("memory", "ok", found)
    crowded = processes and needed_mb(uavs, -(-uavs // _ROWS), keeps_states) <= available
    mend = f"more UAVs in a process: --uavs-per-process {_ROWS}" if crowded else "fewer UAVs: --uavs N"
    return Finding("memory", "fails", found, mend)


def open_files(uavs: int, uavs_per_process: int) -> Finding:
    """Whether the launcher may open as many files as it needs."""
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


def _viewer_port() -> Finding:
    try:
        with socket.create_server(("127.0.0.1", VIEWER_PORT)):
            return Finding("live viewer port", "ok", f"{VIEWER_PORT} is free")
    except OSError as error:
        mend = "end what listens there, or run without --view"
        return Finding("live viewer port", "warning", f"{VIEWER_PORT}: {error.strerror}", mend)


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


def _disk(out: Path) -> Finding:
    free = shutil.disk_usage(_existing(out)).free // MEGABYTE
    if free < 200:
        return Finding("disk", "warning", f"{free} MB free", "a recorded run of 25 UAVs takes about 20 MB")
    return Finding("disk", "ok", f"{free} MB free")


def certificates(folder: Path, uavs: int, uavs_per_process: int) -> list[Finding]:
    """Whether everyone's certificate is there, readable, of the same authority and still valid."""
    from groundstation import certs  # a library that most runs need not load

    wanted = certs.names(uavs, uavs_per_process)
    found = [
        Finding(
            "certificate",
            "warning" if problem.mend.startswith("chmod") else "fails",
            f"{problem.path}: {problem.why}",
            problem.mend,
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


def _docker() -> Finding:
    if shutil.which("docker") is None:
        return Finding("docker", "warning", "not found", "only needed for `docker compose up`")
    return Finding("docker", "ok", "client found; `docker compose up` also needs a running engine")
