"""A world that can be watched, and a look at what it says."""

import re
import subprocess
import urllib.request
from collections.abc import Iterable

from prometheus_client.parser import text_string_to_metric_families

from meanflock.groundstation.launch.processes import free_endpoint
from tests.integration.conftest import Spawn
from tests.polling import DEADLINE_S

SHORT = ("--uavs", "3", "--seed", "7", "--duration", "30", "--set", "federation.period=40", "--no-record")
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
