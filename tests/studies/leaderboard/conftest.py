"""Small missions for tests of leaderboards."""

from pathlib import Path

import pytest

from tests.studies.leaderboard.courses import SMALL


@pytest.fixture
def small(tmp_path: Path) -> list[str]:
    for name, more in (("near", ""), ("breeze", "[wind]\nmean = [0.0, 2.0]\n")):
        (tmp_path / f"{name}.toml").write_text(SMALL + more)
    return ["near.toml", "breeze.toml"]
