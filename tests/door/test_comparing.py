"""`mf.compare` and `mf.sweep`: a row a point, the flights those of `mf.fly`, and what is kept is not flown again."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import meanflock as mf
from meanflock.groundstation import study

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
