"""`mf.compare` and `mf.sweep`: a row for each point, from flights of `mf.fly`; finished flights never fly again."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import meanflock as mf
from meanflock.studies import study
from tests.commands import printed

SMALL: dict[str, Any] = {"uavs": 2, "duration": 3.0, "jobs": 1}


def test_controllers_are_compared_by_the_means_of_the_same_seeds() -> None:
    found = mf.compare(["mfg", "hjb"], seeds=3, **SMALL)
    assert [(row["method"], row["n"], row["uavs"]) for row in found] == [("mfg", 3, 2), ("hjb", 3, 2)]
    for row, ((method,), summaries) in zip(found, found.summaries.items(), strict=True):
        assert [summary["seed"] for summary in summaries] == [1, 2, 3]
        alone = mf.fly(method=method, uavs=2, duration=3.0, seed=2)
        assert summaries[1]["trajectory_sha256"] == alone.summary["trajectory_sha256"]
        mean = np.mean([summary["energy_mean_J"] for summary in summaries])
        assert row["energy_mean_J"] == pytest.approx(mean)
        assert row["energy_mean_J_low"] < mean < row["energy_mean_J_high"]


def test_a_key_is_swept_over_numbers_lists_and_tables() -> None:
    rows = list(mf.sweep("wind.sigma", np.linspace(0.1, 0.2, 2), methods=["mfg", "hjb"], seeds=np.int64(1), **SMALL))
    found = [(row["wind.sigma"], row["method"]) for row in rows]
    assert found == [(0.1, "mfg"), (0.1, "hjb"), (0.2, "mfg"), (0.2, "hjb")]
    lists = mf.sweep("wind.mean", [[1.0, -1.0], (0.0, 0.0)], methods="mfg", seeds=1, **SMALL)
    assert [row["wind.mean"] for row in lists] == [(1.0, -1.0), (0.0, 0.0)]
    assert repr(lists) == "<Comparison of 2 points of wind.mean, method: 2 flights>"
    disc = {"centre": [30.0, 0.0], "radius": 2.0}
    tables = mf.sweep("obstacles", [[], [disc]], methods="mfg", seeds=1, **SMALL)
    assert [row["obstacles"] for row in tables] == [(), (str(disc),)]


@pytest.mark.parametrize("kept", [True, False])
def test_ctrl_c_is_a_keyboard_interrupt_and_names_the_kept_flights(kept: bool, tmp_path, monkeypatch) -> None:
    def interrupted(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(study.Store, "add", interrupted)
    with pytest.raises(KeyboardInterrupt) as caught:
        mf.compare("mfg", seeds=2, out=tmp_path if kept else None, **SMALL)
    assert f"kept in {tmp_path / 'data'}" in str(caught.value) if kept else "nothing is kept: name" in str(caught.value)


FORKED = """
import multiprocessing
from concurrent.futures import ProcessPoolExecutor

import meanflock as mf

def flown(jobs=2):
    return [row["payload_bits"] for row in mf.compare("mfg", seeds=2, uavs=2, duration=1, jobs=jobs)]

if __name__ == "__main__":
    here, fork = flown(jobs=1), multiprocessing.get_context("fork")
    with ProcessPoolExecutor(1, mp_context=fork) as pool:
        assert pool.submit(flown).result() == here
    with fork.Pool(1) as pool:
        assert pool.apply(flown) == here
"""


@pytest.mark.processes
def test_flights_fly_in_a_fork_and_in_a_worker_of_another_pool(tmp_path: Path) -> None:
    script = tmp_path / "forked.py"
    script.write_text(FORKED)
    printed(sys.executable, "-W", "error", script, cwd=tmp_path)
