"""Agents that train a model of PyTorch, each in a process of its own: time to take-off, and memory."""

import json
import subprocess
import tempfile
import time
from pathlib import Path
from statistics import median

import psutil

from benchmarks.agent_process import memory_mib
from benchmarks.figure import Effort, Figure, Outcome, Say
from benchmarks.machine import ROOT
from benchmarks.processes import BenchmarkFailed
from meanflock.net.process import end_all

TITLE = "25 agents with PyTorch"
ABOUT = (
    "`meanflock run --learner examples/digits.py`, 25 agents, a process each, which share what the process that forks "
    "them has loaded. *Up and flying* is the time of the command less that of the flight. PSS counts shared memory "
    "once in all. The launcher loads PyTorch, too: it needs the sizes of the model and measures its libraries."
)
AGENTS = 25
UP_TARGET_S, PSS_TARGET_MIB = 25.0, 80e6 / 2**20
PYTHON = ROOT / ".venv-learners" / "bin" / "python"
FLOWN = ("--learner", "examples/digits.py", "--method", "plan", "--uavs", str(AGENTS), "--duration", "60")
SETTINGS = ("--set", "stop=duration", "--set", "federation.fraction=1", "--set", "federation.period=20")
_DEADLINE_S = 240.0
_EVERY_S = 0.5


def run(effort: Effort, say: Say) -> Outcome:
    """Whole flights of the command, one after the other."""
    if not PYTHON.exists():
        raise BenchmarkFailed("there is no .venv-learners; make learners")
    up: list[float] = []
    pss: list[float] = []
    launcher: list[float] = []
    for repeat in range(effort.choose(3, 1)):
        say(f"flight {repeat + 1}")
        seconds, agents, ours = _fly()
        up.append(seconds)
        pss.append(median(agents))
        launcher.append(ours)
    return Outcome(
        [
            Figure(f"{AGENTS} agents with PyTorch up and flying", "s", up, target=UP_TARGET_S),
            Figure("PSS of an agent in flight", "MiB", pss, target=PSS_TARGET_MIB),
            Figure("PSS of the launcher", "MiB", launcher, "neither"),
        ]
    )


def _fly() -> tuple[float, list[float], float]:
    """Seconds of the command less those of the flight, and the last PSS of each agent and of the launcher, MiB."""
    pss: list[float] = []
    ours = 0.0
    with tempfile.TemporaryDirectory(prefix="meanflock-bench-") as out:
        command = [str(PYTHON), "-m", "meanflock.cli", "run", *FLOWN, *SETTINGS, "--no-record", "--quiet", "--json"]
        start = time.perf_counter()
        printed = Path(out) / "summary.json"
        with printed.open("w", encoding="utf-8") as file:
            launcher = subprocess.Popen([*command, "--out", out], cwd=ROOT, stdout=file)
        try:
            while launcher.poll() is None:
                if time.perf_counter() - start > _DEADLINE_S:
                    raise BenchmarkFailed(f"the flight has not ended within {_DEADLINE_S:g} s")
                time.sleep(_EVERY_S)
                if len(found := _agents(launcher.pid)) == AGENTS:
                    pss, ours = found, memory_mib(launcher)[1]
            wall_s = time.perf_counter() - start
        finally:
            end_all([launcher])
        if launcher.returncode or not pss:
            raise BenchmarkFailed(f"the flight ended with exit code {launcher.returncode}, or too soon to be weighed")
        summary = json.loads(printed.read_text(encoding="utf-8"))
    return wall_s - summary["wall_time_s"], pss, ours


def _agents(launcher: int) -> list[float]:
    """PSS of the agents that are there, MiB."""
    try:
        processes = psutil.Process(launcher).children(recursive=True)
        return [memory_mib(one)[1] for one in processes if one.name() == "mf-agent"]
    except (psutil.Error, OSError, KeyError):  # some have ended
        return []
