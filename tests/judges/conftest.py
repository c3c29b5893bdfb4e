"""The interpreter of a module's judge, in an environment of its own."""

from pathlib import Path

import pytest

from benchmarks.peer.environment import Environment


@pytest.fixture(scope="module")
def python(request: pytest.FixtureRequest) -> Path:
    """The interpreter of an environment with the libraries of the module's `JUDGE`, which is made once and kept."""
    environment = Environment(request.module.JUDGE, kind="judge")
    environment.make(timeout_s=280.0)
    return environment.python
