"""The grid is flown once, whatever happens while it is flown."""

import errno
import os
import shutil
from collections import Counter
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from meanflock.studies import code_version, job_file
from meanflock.studies.paper import experiments, tables
from meanflock.studies.paper.grid import Point, Wanted
from meanflock.studies.paper.tables import COORDINATES
from meanflock.studies.store import Store
from meanflock.swarm.errors import BadInput, RunFailed
from tests.studies.tiny import fly, plan, same, tiny


@pytest.fixture
def executed(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """How often every run was flown in this process."""
    count: Counter[str] = Counter()
    execute = experiments.execute

    def counting(run: Wanted) -> bytes:
        count[run.key] += 1
        return execute(run)

    monkeypatch.setattr(experiments, "execute", counting)
    return count


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a plan that was flown."""
    out = tmp_path_factory.mktemp("kept")
    fly(out)
    return out


@pytest.fixture
def flown(kept: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    return Path(shutil.copytree(kept, tmp_path / "flown"))


def test_tables_are_those_the_docstring_promises(tmp_path: Path, executed: Counter[str]) -> None:
    results = fly(tmp_path)
    runs = results.runs.to_pylist()
    assert [(row["experiment"], row["method"], row["seed"]) for row in runs] == [
        (run.point.experiment, run.scenario.method, run.seed) for run in plan()
    ]
    assert set(executed.values()) == {1}
    assert len(executed) == len(runs) - 2  # `uavs` shares its runs with `s0`
    assert results.runs.schema.names[: len(COORDINATES)] == COORDINATES.names
    words = set((tables.__doc__ or "").replace(",", " ").replace("(", " ").split())
    for name in ("t_avg_s", "key", "uplink_outage_rate", "phi_G_125", "value_norm_max", *results.series.column_names):
        assert name in words, name
        assert name in {*results.runs.column_names, *results.series.column_names}, name
    hf, offline = runs[0], next(row for row in runs if row["experiment"] == "offline")
    assert (hf["period"], hf["sigma"], hf["setting"], hf["trained"]) == (10, 0.1, "", False)
    assert offline["hjb_residual_max"] is None
    assert offline["period"] is None
    assert hf["phi_A_175"] is None
    shown = {(row["experiment"], row["method"], row["seed"]) for row in results.series.to_pylist()}
    assert ("sensitivity", "mfg", 1) not in shown
    assert len(shown) == len(runs) - 2
    first = results.series.to_pylist()[0]
    assert first["t_s"] == 0.0
    assert first["hjb_abs_mean"] is None
    traced = {(row["experiment"], row["method"], row["seed"]) for row in results.trajectories.to_pylist()}
    assert traced == {("s0", "mfgfl-hf", 1), ("s0", "hjb", 1), ("offline", "offline", 1), ("trained", "mfgfl-hf", 1)}
    assert len(results.weights["model"][0].as_py()) == 246
    assert same(tables.load(tmp_path), results)


def test_a_finished_run_is_never_flown_again(tmp_path: Path, executed: Counter[str]) -> None:
    first = fly(tmp_path, only={"s0"})
    assert len(executed) == 4
    assert first.runs.num_rows == 6  # the runs of `uavs` are there as well
    whole = fly(tmp_path)
    assert set(executed.values()) == {1}
    assert same(whole, fly(tmp_path))
    assert set(executed.values()) == {1}


def test_more_seeds_add_to_what_is_there(tmp_path: Path, executed: Counter[str]) -> None:
    point = Point("uavs", tiny("mfg"))
    fly(tmp_path, plan=[Wanted(point, 1)])
    fly(tmp_path, plan=[Wanted(point, seed) for seed in (1, 2, 3)])
    assert sorted(executed.values()) == [1, 1, 1]


def test_processes_change_nothing(kept: Path, tmp_path: Path) -> None:
    assert same(tables.load(kept), fly(tmp_path, jobs=2))


@pytest.mark.parametrize("damage", ["cut", "flipped", "empty", "foreign"])
def test_a_damaged_file_is_flown_again(flown: Path, executed: Counter[str], damage: str) -> None:
    whole = tables.load(flown)
    path = sorted((flown / "data/jobs").glob("*.job"))[0]
    raw = path.read_bytes()
    flipped = bytearray(raw)
    flipped[len(raw) // 2] ^= 1
    path.write_bytes(
        {"cut": raw[: len(raw) // 2], "flipped": bytes(flipped), "empty": b"", "foreign": b"hello"}[damage]
    )
    assert same(fly(flown), whole)
    assert 0 < len(executed) < whole.runs.num_rows - 2


def test_results_of_other_code_are_flown_again(
    flown: Path, executed: Counter[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    fly(flown)
    assert not executed
    monkeypatch.setattr(job_file, "version", lambda: "9.9.9+other")
    fly(flown)
    assert set(executed) == {run.key for run in plan()}


def test_code_in_any_folder_of_a_room_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "folder").mkdir()
    monkeypatch.setattr(code_version, "_ROOMS", (SimpleNamespace(__file__=str(tmp_path / "__init__.py")),))
    versions = set()
    for source in ("a = 1", "a = 2"):
        (tmp_path / "folder" / "module.py").write_text(source)
        versions.add(code_version.version.__wrapped__())
    assert len(versions) == 2


def test_words_are_not_code() -> None:
    before = code_version._syntax('def f() -> int:\n    """One."""\n    return 1\n')
    assert code_version._syntax('def f() -> int:\n    """Two words."""\n    # why\n    return 1\n') == before
    assert code_version._syntax('def f() -> int:\n    """One."""\n    return 2\n') != before


def test_interrupted_and_taken_up_again(
    tmp_path: Path, executed: Counter[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    add, calls = Store.add, []

    def interrupted(self: Store, raw: bytes) -> None:
        if calls:
            raise KeyboardInterrupt
        calls.append(1)
        add(self, raw)

    monkeypatch.setattr(Store, "add", interrupted)
    with pytest.raises(RunFailed, match="repeat the command"):
        fly(tmp_path)
    done = len(list((tmp_path / "data/jobs").glob("*.job")))
    assert done == 1
    monkeypatch.setattr(Store, "add", add)
    results = fly(tmp_path)
    assert results.runs.num_rows == len(plan())
    assert Counter(executed.values())[2] <= 2  # only the run that was under way


def test_a_full_disk_is_said_and_costs_nothing(
    tmp_path: Path, executed: Counter[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    sync, calls = os.fsync, []

    def full(descriptor: int) -> None:
        calls.append(1)
        if len(calls) > 2:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        sync(descriptor)

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(RunFailed, match=r"No space left on device.*kept"):
        fly(tmp_path)
    monkeypatch.setattr(os, "fsync", sync)
    left = {path.suffix for path in (tmp_path / "data/jobs").iterdir()}
    assert left == {".job"}
    assert len(Store(tmp_path).finished()) >= 1
    assert fly(tmp_path).runs.num_rows == len(plan())


def test_an_error_says_where(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("no")

    monkeypatch.setattr(experiments, "fly", broken)
    with pytest.raises(RunFailed, match=r"s0 hjb, seed 1: ZeroDivisionError"):
        fly(tmp_path)


def test_a_worker_with_other_code_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    raw = job_file.encode([])
    monkeypatch.setattr(job_file, "version", lambda: "9.9.9+other")
    with pytest.raises(RunFailed, match="same code"):
        Store(tmp_path).add(raw)


def test_diverged_runs_stay_and_are_counted(tmp_path: Path) -> None:
    wild = tiny("mfg", "learner.position_scale=30", "learner.velocity_scale=3", duration=30.0)
    results = fly(tmp_path, plan=[Wanted(Point("sensitivity", wild), 1), Wanted(Point("s0", tiny("mfg")), 1)])
    assert results.runs.num_rows == 2
    assert results.diverged == 1
    assert results.runs["diverged"].to_pylist() == [True, False]


@pytest.mark.parametrize(
    "options",
    [{"only": {"s1"}}, {"backend": "ray"}, {"scheduler": "tcp://127.0.0.1:1"}],
)
def test_what_cannot_be_asked_for(tmp_path: Path, options: dict[str, Any]) -> None:
    with pytest.raises(BadInput):
        fly(tmp_path / "out", **options)
    assert not (tmp_path / "out").exists()


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(BadInput, match="--out"):
        fly(tmp_path / "file")
