"""What all tests of the ground station may use."""

from collections.abc import Iterator

import pytest
import rerun as rr


@pytest.fixture
def strict() -> Iterator[None]:
    """Bad data for a recording raises instead of warning."""
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)
