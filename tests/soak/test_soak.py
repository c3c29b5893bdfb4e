"""A short soak: every kind of mishap at least once. `make soak` flies ten thousand ticks of them."""

from pathlib import Path

import pytest

from tests.soak.soak import Soak


@pytest.mark.processes
@pytest.mark.xdist_group("soak")
def test_nodes_that_are_killed_frozen_and_started_again_by_hand_break_no_promise(tmp_path: Path) -> None:
    report = Soak(uavs=5, ticks=300, every=30, seed=1, out=tmp_path).run()
    assert report.broken == []
    assert len(report.mishaps) == 10
