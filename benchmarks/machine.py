"""Conditions of a measurement: machine, versions, commit and load."""

import importlib.metadata
import os
import platform
import subprocess
from pathlib import Path
from typing import Any

import psutil

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("numpy", "eclipse-zenoh", "msgspec", "scipy", "pyarrow", "rerun-sdk")
BUSY_LOAD = 0.7


def machine() -> dict[str, Any]:
    """Hardware and system."""
    return {
        "cpu": _cpu(),
        "cores": os.cpu_count(),
        "memory_GiB": round(psutil.virtual_memory().total / 2**30, 1),
        "system": f"{platform.system()} {platform.release()}",
        "load_before": round(os.getloadavg()[0], 2),
    }


def versions() -> dict[str, str]:
    """Versions of Python, meanflock and its dependencies; "absent" if not installed."""
    found = {"python": platform.python_version(), "meanflock": _version("meanflock"), "commit": _commit()}
    return found | {name: _version(name) for name in PACKAGES}


def _cpu() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "absent"


def _commit() -> str:
    """The short hash, with a plus where the checkout has changes; "unknown" outside a checkout."""
    head = _git("rev-parse", "--short", "HEAD")
    if head is None:
        return "unknown"
    changed = _git("status", "--porcelain", "--untracked-files=no", "--", "*.py", "*.toml")
    return head.strip() + ("+" if changed else "")


def _git(*words: str) -> str | None:
    command = ["git", "-C", str(ROOT), *words]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout
    except (OSError, subprocess.SubprocessError):
        return None


def committed(path: str) -> str | None:
    """A file of the last commit; None if it is not there."""
    return _git("show", f"HEAD:{path}")
