"""Runs of the real command, their files and processes; a world that can be watched."""

import json
import os
import re
import subprocess
import sys
import urllib.request
from collections.abc import Callable, Iterable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import psutil
import pytest
from prometheus_client.parser import text_string_to_metric_families

from meanflock.groundstation.cli.command import main
from meanflock.groundstation.launch.processes import free_endpoint
from tests.polling import DEADLINE_S

Spawn = Callable[..., "subprocess.Popen[str]"]


def processes_of(text: str) -> list[psutil.Process]:
    """Other living processes of this worker's tests with `text` in their command line."""
    ours = {name: os.environ.get(name) for name in ("PYTEST_XDIST_TESTRUNUID", "PYTEST_XDIST_WORKER")}
    found = []
    for process in psutil.process_iter(["cmdline", "status", "environ"]):
        alive = process.info["status"] != psutil.STATUS_ZOMBIE and process.pid != os.getpid()
        if alive and any(text in part for part in process.info["cmdline"] or []):
            environ = process.info["environ"] or {}
            if {name: environ.get(name) for name in ours} == ours:
                found.append(process)
    return found


@pytest.fixture
def spawn() -> Iterator[Spawn]:
    """Starts `python -m …`; whatever still runs at the end of the test, passed or failed, is killed."""
    started: list[subprocess.Popen[str]] = []

    def start(*arguments: str) -> "subprocess.Popen[str]":
        line = [sys.executable, "-m", *arguments]
        started.append(subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True))
        return started[-1]

    yield start
    for process in started:
        if process.poll() is None:
            process.kill()
            process.communicate()


class Command:
    """`meanflock run` in a folder of its own."""

    def __init__(self, out: Path, spawn: Spawn) -> None:
        self.out, self._spawn = out, spawn

    def start(self, *flags: str) -> "subprocess.Popen[str]":
        return self._spawn("meanflock.groundstation.cli", "run", "--out", str(self.out), *flags)

    def summary(self, *flags: str) -> dict[str, Any]:
        """Runs the command in this process to its end; the summary."""
        with redirect_stdout(StringIO()) as out, redirect_stderr(StringIO()) as err:
            assert main(["run", "--out", str(self.out), "--json", "--quiet", *flags]) == 0, err.getvalue()
        assert "not all processes ended" not in err.getvalue()
        sys.stderr.write(err.getvalue())
        return json.loads(out.getvalue())

    def summary_of_a_process(self, *flags: str) -> dict[str, Any]:
        """The same of a command in a process of its own, which prints nothing else."""
        process = self.start("--json", "--quiet", *flags)
        out, err = process.communicate(timeout=DEADLINE_S)
        assert process.returncode == 0, err
        return json.loads(out)

    @property
    def folder(self) -> Path:
        """The only run folder."""
        (folder,) = self.out.iterdir()
        return folder


@pytest.fixture
def command(tmp_path: Path, spawn: Spawn) -> Command:
    return Command(tmp_path / "runs", spawn)


WATCHED = ("--uavs", "3", "--seed", "7", "--duration", "30", "--set", "federation.period=40", "--no-record")
ENDLESS = ("--duration", "100000", "--set", "stop=duration")
SETTINGS = ("uavs=3", "seed=7", "duration=30", "federation.period=40")


def scrape(url: str) -> dict[tuple[str, frozenset[tuple[str, str]]], float]:
    with urllib.request.urlopen(url, timeout=DEADLINE_S) as answer:
        families = text_string_to_metric_families(answer.read().decode())
        return {(s.name, frozenset(s.labels.items())): s.value for family in families for s in family.samples}


def told_url(stream: Iterable[str]) -> str:
    """The address a process says it can be read at."""
    for line in stream:
        if found := re.search(r"metrics at (http://127\.0\.0\.1:\d+/metrics)", line):
            return found[1]
    raise AssertionError("no address was told")


def world(spawn: Spawn, *flags: str) -> tuple["subprocess.Popen[str]", tuple[str, ...]]:
    base = ("--endpoint", free_endpoint(), "--run", "watched")
    sets = (word for setting in SETTINGS for word in ("--set", setting))
    return spawn("meanflock.worldsim", *base, *sets, *flags), base
