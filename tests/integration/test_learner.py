"""A learner on processes: the bits of one process, and the same after a process was killed."""

import json
import os
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.commands import printed
from tests.sources import ROOT

pytestmark = pytest.mark.processes

FILE = ROOT / "tests" / "agent" / "learning" / "lines.py"
FLOWN = ("--method", "orca", "--uavs", "4", "--duration", "15", "--no-record", "--json", "--quiet", "--learner", FILE)
SLOW = ("training.fit_s=1.1", "training.spread=0.5", "training.power_W=2", "federation.fraction=1", "filter.kind=ecbf")


def summary(out: Path, *flags: str) -> dict[str, Any]:
    settings = (part for setting in SLOW for part in ("--set", setting))
    command = (sys.executable, "-m", "meanflock", "run", *FLOWN, *settings, "--out", out, *flags)
    return json.loads(printed(*command, env=os.environ | {"PYTHONPATH": str(ROOT)}, timeout=120))


def test_learners_in_one_process_and_in_one_each_have_the_same_bits(tmp_path: Path) -> None:
    one, two, four = (summary(tmp_path, *flags) for flags in (("--in-process",), ("--uavs-per-process", "2"), ()))
    assert one["lost"] == 0
    assert one["rounds"] >= 6
    for key in ("models_sha256", "trajectory_sha256", "payload_bits", "diagnostics", "energy_compute_J"):
        assert one[key] == two[key] == four[key], key
