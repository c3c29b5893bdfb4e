"""Processes of a benchmark: nodes of a swarm, floor clients, the command itself. Ended by their ids, never orphaned."""

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from typing import Any

from meanflock.launch.children import Family
from meanflock.launch.processes import free_endpoint

from benchmarks.machine import ROOT
from meanflock.net.process import end_all

COMMAND = (sys.executable, "-m", "meanflock.cli")
_COMMAND_S = 150.0


class BenchmarkFailed(Exception):
    """A process of the benchmark failed; the text names it and its output."""


class Children(Family):
    """Context of processes that share an endpoint and a run name; at its end none is left."""

    def __init__(self, run: str) -> None:
        super().__init__()
        self.run, self.endpoint = run, free_endpoint()
        self.processes: list[subprocess.Popen[bytes]] = []

    def start(self, module: str, *flags: str) -> "subprocess.Popen[bytes]":
        """`python -m module --endpoint … --run … flags`; a room of ours, or a module of the benchmarks."""
        command = [sys.executable, "-m", module, "--endpoint", self.endpoint, "--run", self.run, *flags]
        process = self.popen(command, self.folder / f"{len(self.processes)}.log", os.environ, ROOT)
        self.processes.append(process)
        return process

    def check(self) -> None:
        """Raises BenchmarkFailed if a process has crashed, with the last thing it said."""
        for number, process in enumerate(self.processes):
            if process.poll():
                messages = (self.folder / f"{number}.log").read_text(errors="replace").splitlines()[-1:]
                raise BenchmarkFailed(f"{process.args[2]} ended with {process.returncode}: {messages}")  # type: ignore[index]

    def wait(self, timeout_s: float) -> None:
        """Wait until all have ended by themselves; `close` ends the others."""
        end = time.monotonic() + timeout_s
        for process in self.processes:
            try:
                process.wait(max(0.0, end - time.monotonic()))
            except subprocess.TimeoutExpired:
                return

    def close(self) -> None:
        """End all processes: SIGTERM, then SIGKILL."""
        end_all(self.processes)
        self.processes = []
        super().close()


def meanflock(*flags: str) -> tuple[dict[str, Any], float]:
    """`meanflock run --json --quiet …` in a folder that is thrown away: its summary, and its wall time in s.

    Raises:
        BenchmarkFailed: it failed; the text is the last line it said.
    """
    with tempfile.TemporaryDirectory(prefix="meanflock-bench-") as out:
        command = [*COMMAND, "run", "--json", "--quiet", "--out", out, *flags]
        start = time.perf_counter()
        printed, messages, code = captured(command, _COMMAND_S)
        wall_s = time.perf_counter() - start
    if code:
        raise BenchmarkFailed(f"meanflock run {' '.join(flags)}: {(messages.splitlines() or ['it said nothing'])[-1]}")
    return json.loads(printed), wall_s


def captured(command: list[str], timeout_s: float) -> tuple[str, str, int]:
    """Standard output, standard error and exit code; interrupted with us, and with it whatever it started."""
    process = subprocess.Popen(
        command,
        cwd=ROOT,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        printed, messages = process.communicate(timeout=timeout_s)
    except BaseException as error:
        process.send_signal(signal.SIGINT)  # a run that is interrupted ends its own processes
        try:
            process.communicate(timeout=20.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
        if isinstance(error, subprocess.TimeoutExpired):
            raise BenchmarkFailed(f"{' '.join(command[1:4])}: not done within {timeout_s:.0f} s") from error
        raise
    return printed, messages, process.returncode
