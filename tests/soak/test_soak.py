"""A few mishaps of the soak, in the normal tests. `make soak` flies ten thousand ticks of them."""

from pathlib import Path

import pytest

from tests.soak.soak import Soak


@pytest.mark.processes
def test_a_flight_on_a_bad_day_keeps_every_promise(tmp_path: Path) -> None:
    report = Soak(uavs=5, ticks=640, every=50, seed=1, out=tmp_path).run()
    assert report.broken == []
    assert sum(report.mishaps.values()) >= 2
    assert report.summary["ticks"] == report.events["finished"] * 640
