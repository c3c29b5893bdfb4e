"""`mf.compare` and `mf.sweep`: a row a point, the flights those of `mf.fly`, and what is kept is not flown again."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import meanflock as mf
from meanflock.studies import study
from meanflock.swarm import plugins
from meanflock.swarm.plugins import registry
from tests.polling import DEADLINE_S

SMALL: dict[str, Any] = {"uavs": 2, "duration": 3.0, "jobs": 1}


def test_controllers_are_compared_over_the_same_seeds() -> None:
    found = mf.compare(["mfg", "hjb"], seeds=3, **SMALL)
    rows = list(found)
    assert [row["method"] for row in rows] == ["mfg", "hjb"]
    assert [(row["n"], row["uavs"]) for row in rows] == [(3, 2), (3, 2)]
    assert len(found) == 2
    for (method,), summaries in found.summaries.items():
        assert [summary["seed"] for summary in summaries] == [1, 2, 3]
        alone = mf.fly(method=method, uavs=2, duration=3.0, seed=2)
        assert summaries[1]["trajectory_sha256"] == alone.summary["trajectory_sha256"]


def test_a_mean_is_that_of_the_flights_between_its_ends() -> None:
    found = mf.compare(["mfg"], seeds=4, **SMALL)
    (row,) = found
    energies = [summary["energy_mean_J"] for summary in found.summaries["mfg",]]
    (name,) = [name for name in row if name.startswith("energy") and not name.endswith(("_low", "_high"))]
    assert row[name] == pytest.approx(np.mean(energies))
    assert row[f"{name}_low"] < row[name] < row[f"{name}_high"]


def test_a_key_is_swept_with_every_controller() -> None:
    rows = list(mf.sweep("wind.sigma", [0.1, 0.3], methods=["mfg", "hjb"], seeds=2, **SMALL))
    assert [(row["wind.sigma"], row["method"]) for row in rows] == [
        (0.1, "mfg"), (0.1, "hjb"), (0.3, "mfg"), (0.3, "hjb")
    ]  # fmt: skip


def test_what_is_kept_is_not_flown_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = list(mf.compare(["mfg"], seeds=2, out=tmp_path, **SMALL))
    monkeypatch.setattr(study, "Engine", lambda *_, **__: pytest.fail("flown twice"))
    assert list(mf.compare(["mfg"], seeds=2, out=tmp_path, **SMALL)) == first


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: mf.compare([], seeds=2, **SMALL), "name a controller"),
        (lambda: mf.compare(["mfg"], seeds=0, **SMALL), "seeds: 0; give how many"),
        (lambda: mf.compare(["mfg"], seeds=[1, 2], **SMALL), r"seeds: \[1, 2\]; give how many"),
        (lambda: mf.sweep("wind.sigma", [0.1], seeds=0, **SMALL), "seeds: 0; give how many"),
        (lambda: mf.sweep("wind.sigma", [], **SMALL), "a value or more"),
        (lambda: mf.compare(["mfg"], seeds=2, **{**SMALL, "jobs": 0}), "jobs: 0; give a number of processes"),
        (lambda: mf.sweep("wind.sigma", [0.1], seeds=2, **{**SMALL, "jobs": "2"}), "jobs: '2'; give a number"),
        (lambda: mf.compare(["nobody"], seeds=2, **SMALL), "'nobody' is not installed"),
        (lambda: mf.sweep("wind.sigma", [0.1, -1.0], **SMALL), "wind.sigma"),
        (lambda: mf.sweep("wind.sgima", [0.1, 0.2], **SMALL), "sgima"),
        (lambda: mf.sweep("wind.sigma", [0.1], **{"wind.sigma": 0.2}, **SMALL), "leave it out"),
    ],
)
def test_what_cannot_be_compared_is_refused_before_anything_is_flown(
    call: Any, says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(study, "fly_all", lambda *_, **__: pytest.fail("flown in vain"))
    with pytest.raises(mf.BadInput, match=says):
        call()


def test_one_controller_alone_may_be_named_without_a_list() -> None:
    assert [row["method"] for row in mf.compare("mfg", seeds=1, **SMALL)] == ["mfg"]
    rows = mf.sweep("wind.sigma", np.linspace(0.1, 0.2, 2), methods="mfg", seeds=np.int64(1), **SMALL)
    assert [(row["wind.sigma"], row["method"]) for row in rows] == [(0.1, "mfg"), (0.2, "mfg")]


def test_values_of_a_sweep_may_be_lists() -> None:
    found = mf.sweep("wind.mean", [[1.0, -1.0], (0.0, 0.0)], methods=["mfg"], seeds=1, **SMALL)
    assert [row["wind.mean"] for row in found] == [(1.0, -1.0), (0.0, 0.0)]
    assert repr(found) == "<Comparison of 2 points of wind.mean, method: 2 flights>"


def test_values_of_a_sweep_may_be_tables() -> None:
    disc = {"centre": [30.0, 0.0], "radius": 2.0}
    found = mf.sweep("obstacles", [[], [disc]], methods="mfg", seeds=1, **SMALL)
    assert [row["obstacles"] for row in found] == [(), (str(disc),)]


@pytest.mark.parametrize("kept", [True, False])
def test_ctrl_c_is_one_and_says_what_is_kept(kept: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(study.Store, "add", interrupted)
    with pytest.raises(KeyboardInterrupt) as caught:
        mf.compare("mfg", seeds=2, out=tmp_path if kept else None, **SMALL)
    assert f"kept in {tmp_path / 'data'}" in str(caught.value) if kept else "nothing is kept: name" in str(caught.value)


def test_flights_of_another_version_of_a_package_are_flown_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "stranger.py").write_text(
        "import meanflock as mf\n\nclass Still(mf.Controller):\n    name = 'still'\n"
        "    def step(self, memory, tick, own, received):\n        return mf.Step(memory, 0.0 * own[:, :2])\n"
    )
    monkeypatch.syspath_prepend(tmp_path)

    def key(version: str) -> str:
        plugin = plugins.Plugin("controller", "still", f"stranger {version}", "stranger:Still", f"stranger {version}")
        installed = {**registry._packaged(), ("controller", "still"): (plugin,)}
        with monkeypatch.context() as patch:
            patch.setattr(registry, "_packaged", lambda: installed)
            return study.key_of(mf.Scenario(method="still"))

    assert key("1.0") == key("1.0") != key("1.1")
    assert study.key_of(mf.Scenario(method="mfg")).count(":") == 1


FORKED = """
import multiprocessing
from concurrent.futures import ProcessPoolExecutor

import meanflock as mf

def flown():
    return [row["payload_bits"] for row in mf.compare("mfg", seeds=2, uavs=2, duration=1, jobs=2)]

if __name__ == "__main__":
    here, fork = flown(), multiprocessing.get_context("fork")
    with ProcessPoolExecutor(1, mp_context=fork) as pool:
        assert pool.submit(flown).result() == here
    with fork.Pool(1) as pool:
        assert pool.apply(flown) == here
    assert flown() == here
"""


@pytest.mark.processes
def test_flights_are_flown_in_a_fork_and_in_a_worker_of_somebody_else(tmp_path: Path) -> None:
    script = tmp_path / "forked.py"
    script.write_text(FORKED)
    subprocess.run([sys.executable, "-W", "error", script], cwd=tmp_path, timeout=DEADLINE_S, check=True)
