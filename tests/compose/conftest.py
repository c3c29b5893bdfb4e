"""The engine, and a project or a clone on it that is gone after the test.

Run by `make test-compose`, which builds the images first. Skipped where no engine runs.
"""

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.compose.containers import USER, Clone, Compose


@pytest.fixture
def compose(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Compose]:
    out = tmp_path / "runs"
    out.mkdir()
    os.chown(out, USER, os.getgid() or USER)
    project = Compose(f"meanflock-test-{os.getpid()}", out)
    yield project
    if request.session.testsfailed:
        print(project("logs", "--tail", "30", check=False))
    project("down", "-v", "--remove-orphans", "--timeout", "2", check=False)
    shutil.rmtree(out, ignore_errors=True)


@pytest.fixture
def clone(tmp_path: Path) -> Iterator[Clone]:
    fresh = Clone(tmp_path / "meanflock", f"meanflock-clone-{os.getpid()}")
    yield fresh
    fresh.down()
    shutil.rmtree(fresh.out, ignore_errors=True)
