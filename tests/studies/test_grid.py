"""The grid of the paper's experiments: what is flown, and each once."""

from collections import Counter

from meanflock.studies.paper import experiments, grid
from meanflock.studies.paper.experiments import to_do
from meanflock.studies.paper.grid import EXPERIMENTS


def test_the_grid_flies_what_the_claims_need() -> None:
    points = list(grid.points())
    flown = {
        (p.experiment, str(p.flown.method), p.flown.uavs, p.flown.period_ticks, p.flown.wind.sigma) for p in points
    }
    for method, period in (("hjb", 100), ("mfg", 100), ("mfgfl-h", 100), ("mfgfl-f", 100), ("mfgfl-hf", 200)):
        assert ("s0", method, 25, period, 0.1) in flown
        assert {n for e, m, n, _, _ in flown if e == "uavs" and m == method} == {16, 25, 36, 49, 64}
    for method in ("mfgfl-h", "mfgfl-f", "mfgfl-hf"):
        assert {n0 for e, m, _, n0, _ in flown if e == "period" and m == method} == {50, 100, 200, 300, 400, 500}
    for method in ("hjb", "mfgfl-h", "mfgfl-f", "mfgfl-hf"):
        assert {s for e, m, _, _, s in flown if e == "wind" and m == method} == {0.1, 0.2, 0.3, 0.4, 0.5}
    assert {s for e, m, _, _, s in flown if e == "offline"} == {0.0, 0.1}
    trained = [p for p in points if p.training is not None]
    assert [(p.flown.wind.sigma, p.training.wind.sigma) for p in trained if p.training] == [(1.5, 0.1)]
    assert {p.experiment for p in points} == set(EXPERIMENTS)
    assert all(p.flown.stop == "duration" and p.flown.max_ticks == 3000 for p in points)


def test_rows_are_unique_and_shared_runs_are_flown_once() -> None:
    rows = grid.wanted(3)
    labels = Counter(
        (r.point.experiment, r.scenario.sha256(), r.point.setting, r.point.training is not None) for r in rows
    )
    assert set(labels.values()) == {1}
    left = to_do(rows, {})
    flown = Counter(run.key for run in left)
    assert set(flown.values()) == {1}
    assert set(flown) == {row.key for row in rows}
    assert [experiments.work(run) for run in left] == sorted(map(experiments.work, left), reverse=True)
    assert {run.point.experiment for run in left if run.traced} == {"s0", "offline", "trained"}


def test_the_random_design_is_the_same_every_time_and_fills_every_range() -> None:
    design = grid.random_design()
    assert design == grid.random_design()
    assert len(design) == grid.RANDOM_POINTS
    for column in range(len(design[0])):
        assert len({row[column] for row in design}) == grid.RANDOM_POINTS
