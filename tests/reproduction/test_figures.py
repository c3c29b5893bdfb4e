"""Figures and report from synthetic tables."""

import re
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from meanflock.groundstation.plots import plotstyle
from reproduction import figures, report
from reproduction.grid import COMPARED, FEDERATED, PERIODS, SIGMAS, UAVS
from reproduction.tables import Results, View
from reproduction.verdict import evaluate
from tests.groundstation.conftest import every_axis
from tests.reproduction.synthetic import map_rows, results, row

METRICS = ("energy_mean_J", "t_avg_censored_s", "phi_A_tavg", "phi_C_tavg")
CURVES = (
    *("energy_trip_mean_J", "energy_trip_std_J", "bits", "phi_A", "phi_C", "speed_mean_m_s", "speed_max_m_s"),
    *("speed_min_m_s", "distance_mean_m", "hjb_abs_mean", "hjb_abs_max", "fpk_abs_mean", "fpk_abs_max"),
)
PARTS = {"version": "0.1.0+x", "diverged": False, "all_arrived": True}


def _path(where: dict[str, Any]) -> list[dict[str, Any]]:
    """Three UAVs on straight ways to the origin."""
    return [
        {**where, "t_s": float(k), "uav": uav, "x_m": 150.0 - k / 2 + 3 * uav, "y_m": 100.0 - k / 3, "status": 0}
        | {"vx_m_s": -0.5, "vy_m_s": 0.1 * uav}
        for k in range(301)
        for uav in range(3)
    ]


@pytest.fixture(scope="module")
def tables() -> Results:
    """Two seeds of every point that a figure shows."""
    draw = np.random.default_rng(1)
    points: list[tuple[str, Any, dict[str, Any]]] = [
        *(("uavs", method, {"uavs": n}) for method, n in product(COMPARED, UAVS)),
        *(("period", method, {"period": n}) for method, n in product(FEDERATED, PERIODS)),
        *(("wind", method, {"sigma": sigma}) for method, sigma in product(COMPARED, SIGMAS)),
        *(("s0", method, {}) for method in COMPARED),
    ]
    runs = [
        row(experiment, method, seed, **where, **PARTS, key=f"{experiment}-{method}-{seed}-{where}")
        | {metric: 1.0 + float(draw.random()) for metric in METRICS}
        for (experiment, method, where), seed in product(points, (1, 2))
    ]
    series = [
        row("s0", method, seed, t_s=float(t)) | {name: 1.0 + float(draw.random()) for name in CURVES}
        for method, seed, t in product(COMPARED, (1, 2), range(0, 301, 10))
    ]
    traced = [
        *(row("s0", method, 1) for method in COMPARED),
        *(row("offline", "offline", 1, sigma=sigma, setting="start.spacing=6") for sigma in (0.0, 0.1)),
        row("trained", "mfgfl-hf", 1, sigma=1.5, trained=True),
    ]
    weights = [
        {**where, "t_s": float(t), "model": np.linspace(0, t, 246).tolist()}
        for where, t in product(traced, range(0, 300, 50))
    ]
    rows = [*runs, *map_rows()]
    empty = {name: None for each in rows for name in each}
    return results(
        [empty | each for each in rows],
        series=pa.Table.from_pylist(series),
        trajectories=pa.Table.from_pylist([each for where in traced for each in _path(where)]),
        weights=pa.Table.from_pylist(weights),
    )


@pytest.mark.parametrize("name", list(figures.FIGURES))
def test_every_axis_has_a_unit(name: str, tables: Results) -> None:
    with plotstyle.style():
        figure = figures.FIGURES[name][0](View.from_results(tables))
    methods = set(plotstyle.NAMES.values())
    for label in every_axis(figure):
        assert "(" in label or label in methods or "N$" in label or "n_0" in label, label


def test_the_report_has_every_claim_figure_and_reading(tables: Results, tmp_path: Path) -> None:
    (tmp_path / "figures").mkdir()
    for name in figures.FIGURES:
        (tmp_path / "figures" / f"{name}.png").write_bytes(b"a picture")
    measured = {"hjb_value_growth": [1.0, 1.01, 0.99]}
    paths = report.write_report(tables, evaluate(tables, measured), tmp_path, measured)
    assert [path.name for path in paths] == ["report.md", "report.html", "claims.json"]
    markdown, html = (path.read_text() for path in paths[:2])
    for k in range(1, 54):
        assert f"| C{k} |" in markdown
        assert f"id='C{k}'" in html
    assert all(f"figures/{name}.png" in markdown for name in figures.FIGURES)
    assert html.count("data:image/png;base64,") == len(figures.FIGURES)
    for text, words in product((markdown, html), ("Lyapunov function L_s", "diverged", "0.1.0+x", "Prop. 1")):
        assert words in text
    assert not re.search(r"<script|(src|href)=.(https?:|/|figures)", html)  # one file, without links
    columns = 0
    for line in markdown.splitlines():
        cells = len(re.findall(r"(?<!\\)\|", line)) if line.startswith("|") else 0
        assert not (columns and cells) or cells == columns, line
        columns = cells
