"""Runs of the real command, and the processes that they leave."""

import json
import os
import sys
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import psutil
import pytest

from meanflock.cli.command import main
from tests.faults.by_hand import Process, Processes, Recorded


def processes_of(text: str) -> list[psutil.Process]:
    """Other living processes of this worker's tests with `text` in their command line, or in a variable."""
    ours = {name: os.environ.get(name) for name in ("PYTEST_XDIST_TESTRUNUID", "PYTEST_XDIST_WORKER")}
    found = []
    for process in psutil.process_iter(["cmdline", "status", "environ"]):
        alive = process.info["status"] != psutil.STATUS_ZOMBIE and process.pid != os.getpid()
        environ = process.info["environ"] or {}
        named = any(text in part for part in (*(process.info["cmdline"] or ()), *environ.values()))
        if alive and named and {name: environ.get(name) for name in ours} == ours:
            found.append(process)
    return found


class Command(Recorded):
    """`meanflock run` in a folder of its own."""

    def __init__(self, out: Path, processes: Processes) -> None:
        super().__init__(out)
        self._processes = processes

    def start(self, *flags: str) -> Process:
        return self._processes.start("cli", "run", "--out", str(self.out), *flags, base=())

    def summary(self, *flags: str) -> dict[str, Any]:
        """Runs the command in this process to its end; the summary."""
        with redirect_stdout(StringIO()) as out, redirect_stderr(StringIO()) as err:
            assert main(["run", "--out", str(self.out), "--json", "--quiet", *flags]) == 0, err.getvalue()
        assert "not all processes ended" not in err.getvalue()
        sys.stderr.write(err.getvalue())
        return json.loads(out.getvalue())


@pytest.fixture
def command(tmp_path: Path, processes: Processes, monkeypatch: pytest.MonkeyPatch) -> Command:
    monkeypatch.setenv("TESTED_COMMAND", str(tmp_path))  # by which its processes are found
    return Command(tmp_path / "runs", processes)
