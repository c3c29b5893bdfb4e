"""The grid of experiments: its points and tables; finished flights never fly again."""

import shutil
from collections import Counter
from itertools import product
from pathlib import Path
from types import SimpleNamespace

import pytest

from meanflock.studies import job_file, runner
from meanflock.swarm.errors import BadInput
from reproduction import claims, experiments, grid, tables
from reproduction.grid import Wanted
from reproduction.tables import COORDINATES
from tests.reproduction.tiny import fly, plan, same


@pytest.fixture
def executed(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """The number of flights of each run in this process."""
    count: Counter[str] = Counter()
    execute = experiments.execute

    def counting(run: Wanted) -> bytes:
        count[run.key] += 1
        return execute(run)

    monkeypatch.setattr(experiments, "execute", counting)
    return count


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a finished plan."""
    out = tmp_path_factory.mktemp("kept")
    fly(out)
    return out


@pytest.fixture
def flown(kept: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    return Path(shutil.copytree(kept, tmp_path / "flown"))


def test_the_grid_flies_every_experiment_and_method_of_the_claims() -> None:
    points = list(grid.points())
    assert {point.experiment for point in points} == set(grid.EXPERIMENTS)
    assert all(point.flown.stop == "duration" and point.flown.max_ticks == 3000 for point in points)
    flown = {(point.experiment, str(point.flown.method)) for point in points}
    for check in (check for claim in (*claims.load(), *claims.own()) for check in claim.check):
        others = () if check.kind == "best" else check.against  # a best case uses the comparisons that exist
        methods = (*check.subject, *others) if check.source == "runs" else ()
        assert set(product(check.experiments or (check.experiment,), methods)) <= flown, check
    (trained,) = [point for point in points if point.training is not None]
    assert trained.flown.wind.sigma == 1.5


def test_experiments_share_runs_and_the_longest_run_flies_first() -> None:
    rows = grid.wanted(3)
    left = experiments.to_do(rows, {})
    assert Counter(run.key for run in left) == Counter({row.key for row in rows})
    assert [experiments.work(run) for run in left] == sorted(map(experiments.work, left), reverse=True)
    assert {run.point.experiment for run in left if run.traced} == {"s0", "offline", "trained"}
    seeds = {name: {row.seed for row in rows if row.point.experiment == name} for name in grid.EXPERIMENTS}
    assert seeds.pop("map") == {6001, 6002}
    assert seeds.pop("found") == {7001, 7002, 7003}
    assert max(map(max, seeds.values())) < 6000


def test_the_tables_have_the_documented_columns(kept: Path) -> None:
    results = tables.load(kept)
    runs = results.runs.to_pylist()
    assert [(row["experiment"], row["method"], row["seed"]) for row in runs] == [
        (run.point.experiment, run.scenario.method, run.seed) for run in plan()
    ]
    assert results.runs.schema.names[: len(COORDINATES)] == COORDINATES.names
    words = set((tables.__doc__ or "").replace(",", " ").replace("(", " ").split())
    columns = {*results.runs.column_names, *results.series.column_names}
    promised = {"t_avg_s", "key", "uplink_outage_rate", "phi_G_125", "value_norm_max", *results.series.column_names}
    assert promised <= words & columns
    hf, offline = runs[0], next(row for row in runs if row["experiment"] == "offline")
    assert (hf["period"], hf["sigma"], hf["setting"], hf["trained"]) == (10, 0.1, "", False)
    assert (offline["hjb_residual_max"], offline["period"], hf["phi_A_175"]) == (None, None, None)
    first = results.series.to_pylist()[0]
    assert (first["t_s"], first["hjb_abs_mean"]) == (0.0, None)
    with_series = {(row["experiment"], row["method"], row["seed"]) for row in results.series.to_pylist()}
    assert len(with_series) == len(runs) - 2
    assert ("sensitivity", "mfg", 1) not in with_series
    traced = {(row["experiment"], row["method"], row["seed"]) for row in results.trajectories.to_pylist()}
    assert traced == {("s0", "mfgfl-hf", 1), ("s0", "hjb", 1), ("offline", "offline", 1), ("trained", "mfgfl-hf", 1)}
    assert len(results.weights["model"][0].as_py()) == 246


@pytest.mark.parametrize("damage", ["cut", "flipped", "empty", "foreign"])
def test_a_damaged_file_flies_again(flown: Path, executed: Counter[str], damage: str) -> None:
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


def test_the_version_depends_on_the_code_and_not_on_its_docstrings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "folder").mkdir()
    monkeypatch.setattr(job_file, "_ROOMS", (SimpleNamespace(__file__=str(tmp_path / "__init__.py")),))

    def version(source: str, other: str = "") -> str:
        (tmp_path / "folder" / "module.py").write_text(source)
        (tmp_path / "other.txt").write_text(other)
        return str(job_file.version.__wrapped__(tmp_path / "other.txt"))

    before = version('def f() -> int:\n    """One."""\n    return 1\n')
    assert version('def f() -> int:\n    """Two words."""\n    # why\n    return 1\n') == before
    assert version('def f() -> int:\n    """One."""\n    return 2\n') != before
    assert version('def f() -> int:\n    """One."""\n    return 1\n', other="a = 1") != before


def test_bad_options_are_rejected_before_a_folder_is_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed", reason="dask is not installed")
    monkeypatch.setattr(runner, "SCHEDULER_TIMEOUT", "1s")
    nobody = {"backend": "dask", "scheduler": "tcp://127.0.0.1:9"}
    for options in ({"only": {"s1"}}, {"backend": "ray"}, {"scheduler": "tcp://127.0.0.1:1"}, nobody):
        with pytest.raises(BadInput, match=r"s1|ray|127"):
            fly(tmp_path / "out", **options)
    assert not (tmp_path / "out").exists()
