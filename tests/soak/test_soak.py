"""A few mishaps of the soak, in the normal tests. `make soak` flies ten thousand ticks of them."""

from pathlib import Path

import pytest

from tests.soak.soak import Soak
from tests.soak.vitals import Vitals


@pytest.mark.processes
def test_a_flight_on_a_bad_day_keeps_every_promise(tmp_path: Path) -> None:
    report = Soak(uavs=5, ticks=640, every=50, seed=1, out=tmp_path).run()
    assert report.broken == []
    assert sum(report.mishaps.values()) >= 2
    assert report.summary["ticks"] == 640


@pytest.mark.parametrize(("name", "allowed"), [("world", 1.0), ("station 7", 1.9), ("agent 3 (9)", 1.0)])
def test_memory_that_grows_beyond_what_a_process_may_keep_is_named(name: str, allowed: float) -> None:
    """A thousand ticks in 14 s are 9 batches of a recorder."""
    for slope, grows in ((0.9 * allowed, False), (1.1 * allowed, True)):
        vitals = Vitals(None)  # type: ignore[arg-type]
        vitals.memory[name] = [(tick, 150 + slope * tick / 1000) for tick in range(0, 4001, 100)]
        vitals.seconds[name] = [0.014 * tick for tick in range(0, 4001, 100)]
        assert [sentence.split(" grows")[0] for sentence in vitals.broken()] == [f"memory of {name}"] * grows
