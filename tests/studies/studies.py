"""Short studies and their files."""

import csv
import json
import os
import signal
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import psutil

from tests.polling import DEADLINE_S, until

QUICK = ("--duration", "3", "--jobs", "1", "--quiet", "--out", "out")


def flown(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / "runs.jsonl").read_text().splitlines()]


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def interrupted(command: Sequence[str], out: Path, cwd: Path | None = None) -> tuple[int, bytes, bytes]:
    """Sends Ctrl-C to a study and its workers when a flight is finished; exit code, stdout and stderr."""
    study = subprocess.Popen(command, cwd=cwd, stderr=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True)
    jobs = out / "data" / "jobs"
    until(lambda: list(jobs.glob("*.job")) or study.poll() is not None, "a finished flight")
    family = psutil.Process(study.pid).children(recursive=True)
    os.killpg(study.pid, signal.SIGINT)
    printed, said = study.communicate(timeout=DEADLINE_S)
    _, alive = psutil.wait_procs(family, timeout=DEADLINE_S)
    assert not alive
    return study.returncode, printed, said
