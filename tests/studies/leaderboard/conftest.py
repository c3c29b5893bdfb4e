"""Small missions for tests of leaderboards."""

from pathlib import Path

import pytest

SMALL = """
uavs = 3
duration = 4.0
stop = "duration"
[start]
centre = [12.0, 9.0]
"""
QUICK = ("--seeds", "2", "--first-seed", "1", "--jobs", "1", "--quiet", "--out", "out")


@pytest.fixture
def small(tmp_path: Path) -> list[str]:
    for name, more in (("near", ""), ("breeze", "[wind]\nmean = [0.0, 2.0]\n")):
        (tmp_path / f"{name}.toml").write_text(SMALL + more)
    return ["near.toml", "breeze.toml"]
