"""Short studies, small missions and files; tests of studies may use what those of the ground station do."""

import csv
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from tests.groundstation.conftest import run, strict, undrawn

__all__ = ["run", "strict", "undrawn"]

BOARD = ("--seeds", "2", "--first-seed", "1", "--jobs", "1", "--quiet", "--out", "out")
QUICK = ("--duration", "3", "--jobs", "1", "--quiet", "--out", "out")


def flown(folder: Path) -> list[dict[str, Any]]:
    return pq.read_table(folder / "flights.parquet").to_pylist()


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


SMALL = """
uavs = 3
duration = 4.0
stop = "duration"
[start]
centre = [12.0, 9.0]
"""


@pytest.fixture
def small(tmp_path: Path) -> list[str]:
    """Names of two small missions."""
    for name, more in (("near", ""), ("breeze", "[wind]\nmean = [0.0, 2.0]\n")):
        (tmp_path / f"{name}.toml").write_text(SMALL + more)
    return ["near.toml", "breeze.toml"]
