"""Figures and report from synthetic tables: complete, deterministic, with units, and true to the numbers."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from meanflock.groundstation.plots import plotstyle
from meanflock.studies.paper.figures import draw as figures
from meanflock.studies.paper.figures.curves import Bundle, bundle
from meanflock.studies.paper.grid import COMPARED, FEDERATED, PERIODS, SIGMAS, UAVS
from meanflock.studies.paper.methods import Method
from meanflock.studies.paper.report import write
from meanflock.studies.paper.tables import Results
from meanflock.studies.paper.traces import Trace, collisions
from meanflock.studies.paper.verdict import evaluate
from meanflock.studies.paper.view import Frame, View, keep_measured, load_measured
from meanflock.swarm.errors import BadInput
from tests.groundstation.axes import every_axis
from tests.studies.map_rows import map_rows
from tests.studies.synthetic import results, row

METRICS = ("energy_mean_J", "t_avg_censored_s", "phi_A_tavg", "phi_C_tavg")
CURVES = (
    "energy_trip_mean_J",
    "energy_trip_std_J",
    "bits",
    "phi_A",
    "phi_C",
    "speed_mean_m_s",
    "speed_max_m_s",
    "speed_min_m_s",
    "distance_mean_m",
    "hjb_abs_mean",
    "hjb_abs_max",
    "fpk_abs_mean",
    "fpk_abs_max",
)


def _runs() -> list[dict[str, Any]]:
    draw = np.random.default_rng(1)

    def one(experiment: str, method: str, seed: int, **where: Any) -> dict[str, Any]:
        values = {metric: 1.0 + float(draw.random()) for metric in METRICS}
        key = f"{experiment}-{method}-{seed}-{where}"
        return row(
            experiment, method, seed, **where, **values, key=key, version="0.1.0+x", diverged=False, all_arrived=True
        )

    rows = [one("uavs", m, s, uavs=n) for m in COMPARED for n in UAVS for s in (1, 2)]
    rows += [one("period", m, s, period=n) for m in FEDERATED for n in PERIODS for s in (1, 2)]
    rows += [one("wind", m, s, sigma=x) for m in COMPARED for x in SIGMAS for s in (1, 2)]
    return rows + [one("s0", m, s) for m in COMPARED for s in (1, 2)]


def _series() -> pa.Table:
    draw = np.random.default_rng(2)
    return pa.Table.from_pylist(
        [
            {**row("s0", m, s), "t_s": float(t), **{name: 1.0 + float(draw.random()) for name in CURVES}}
            for m in COMPARED
            for s in (1, 2)
            for t in range(0, 301, 10)
        ]
    )


def _path(where: dict[str, Any], uavs: int = 3) -> list[dict[str, Any]]:
    rows = []
    for k in range(301):
        left = 1.0 - k / 300
        for uav in range(uavs):
            place = {"x_m": 150.0 * left + 3 * uav, "y_m": 100.0 * left, "vx_m_s": -0.5, "vy_m_s": 0.1 * uav}
            rows.append({**where, "t_s": k * 1.0, "uav": uav, **place, "status": 0})
    return rows


def _traces() -> tuple[pa.Table, pa.Table]:
    flown = [row("s0", m, 1) for m in COMPARED]
    apart = {"setting": "start.spacing=6"}
    flown += [row("offline", "offline", 1, sigma=sigma, **apart) for sigma in (0.0, 0.1)]
    flown += [row("trained", "mfgfl-hf", 1, sigma=1.5, trained=True)]
    weights = [
        {**where, "t_s": float(t), "model": np.linspace(0, t, 246).tolist()}
        for where in flown
        for t in range(0, 300, 50)
    ]
    paths = [each for where in flown for each in _path(where)]
    return pa.Table.from_pylist(paths), pa.Table.from_pylist(weights)


@pytest.fixture(scope="module")
def tables() -> Results:
    trajectories, weights = _traces()
    rows = [*_runs(), *map_rows()]
    known = {name: None for each in rows for name in each}
    return results([known | each for each in rows], series=_series(), trajectories=trajectories, weights=weights)


@pytest.fixture(scope="module")
def drawn(tables: Results, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("paper")
    figures.draw(tables, out / "figures")
    return out


def test_every_figure_is_drawn_twice_and_not_blank(drawn: Path) -> None:
    for name in figures.FIGURES:
        for suffix in ("png", "svg"):
            assert (drawn / "figures" / f"{name}.{suffix}").stat().st_size > 20_000


@pytest.mark.parametrize("name", ["fig5", "fig8"])
def test_the_same_tables_give_the_same_bytes(name: str, tables: Results, drawn: Path, tmp_path: Path) -> None:
    for path in figures.draw(tables, tmp_path, only=[name]):
        assert path.read_bytes() == (drawn / "figures" / path.name).read_bytes()


def test_svg_says_neither_when_nor_by_whom(drawn: Path) -> None:
    text = (drawn / "figures" / "fig5.svg").read_text()
    assert "<dc:date>" not in text
    assert "matplotlib.org" not in text.split("</metadata>")[0]


def test_only_what_was_asked_for_and_exists(tables: Results, tmp_path: Path) -> None:
    assert {path.name for path in figures.draw(tables, tmp_path, only=["5"])} == {"fig5.png", "fig5.svg"}
    with pytest.raises(BadInput, match="fig9"):
        figures.draw(tables, tmp_path, only=["9"])


def test_what_has_no_data_is_left_out(tmp_path: Path) -> None:
    assert figures.draw(results([row("nothing", "hjb", 1)]), tmp_path) == []


@pytest.mark.parametrize("name", list(figures.FIGURES))
def test_every_axis_has_a_unit(name: str, tables: Results) -> None:
    with plotstyle.style():
        made = figures.FIGURES[name][0](View.of(tables))
    assert made is not None
    methods = set(plotstyle.NAMES.values())
    for label in every_axis(made):
        assert "(" in label or label in methods or "N$" in label or "n_0" in label, label


def test_a_method_has_one_colour_marker_and_dash() -> None:
    assert set(plotstyle.LOOKS) == set(plotstyle.NAMES) == set(Method)
    for each in (*zip(*(look[:3] for look in plotstyle.LOOKS.values()), strict=True), plotstyle.NAMES.values()):
        assert len(set(each)) == len(Method)


def test_every_experiment_of_the_grid_has_its_figure_points(tables: Results) -> None:
    view = View.of(tables)
    assert view.points("uavs") == list(UAVS)
    assert view.points("wind") == pytest.approx(list(SIGMAS))


# -- what is drawn is what is in the tables ------------------------------------------------------------


def test_bundle_puts_every_value_in_its_place() -> None:
    table = pa.table({"seed": [2, 1, 1, 2], "t_s": [0.0, 1.0, 0.0, 1.0], "x": [20.0, 11.0, 10.0, None]})
    curves = bundle(Frame(table), "x")
    assert curves.rows[0].tolist() == [10.0, 11.0]
    assert curves.mean.tolist() == [15.0, 11.0]
    assert Bundle(curves.times, curves.rows[:1]).half.tolist() == [0.0, 0.0]


def test_collisions_between_samples_are_found() -> None:
    """Two UAVs meet at the odd tick between two samples, and only there."""
    states = np.zeros((3, 2, 4))
    states[:, 1, 0] = [1.0, -1.0, -3.0]
    states[1:, 1, 2] = -10.0  # m/s: 1 m back at the tick between
    times, flying = np.array([0.0, 0.2, 0.4]), np.zeros((3, 2), dtype=np.uint8)
    assert collisions(Trace(times, states, flying)) == pytest.approx(np.array([[0.1, 0.0, 0.0]]))
    assert len(collisions(Trace(times, states, np.ones((3, 2), dtype=np.uint8)))) == 0
    states[..., 0] -= 0.5  # they meet on the way from tick to tick
    states[:, 0, 0] = 0.0
    assert collisions(Trace(times, states, flying)) == pytest.approx(np.array([[0.1, -0.25, 0.0]]))


def test_mission_ends_with_the_last_arrival() -> None:
    status = np.array([[0, 0], [1, 0], [1, 2], [1, 2]], dtype=np.uint8)
    assert Trace(np.arange(4.0), np.zeros((4, 2, 4)), status).mission_s == 2.0
    assert Trace(np.arange(4.0), np.zeros((4, 2, 4)), np.zeros((4, 2), dtype=np.uint8)).mission_s == 3.0


# -- the report ------------------------------------------------------------


@pytest.fixture(scope="module")
def written(tables: Results, drawn: Path) -> tuple[str, str]:
    measured = {"hjb_value_growth": [1.0, 1.01, 0.99]}
    paths = write.write_report(tables, evaluate(tables, measured), drawn, measured)
    return paths[0].read_text(), paths[1].read_text()


def test_report_has_every_claim_figure_and_reading(written: tuple[str, str]) -> None:
    markdown, html = written
    for k in range(1, 54):
        assert f"| C{k} |" in markdown
        assert f"id='C{k}'" in html
    for name in figures.FIGURES:
        assert f"figures/{name}.png" in markdown
    assert html.count("data:image/png;base64,") == len(figures.FIGURES)
    for text in (markdown, html):
        assert "Lyapunov function L_s" in text
        assert "diverged" in text
        assert "0.1.0+x" in text
        assert "Prop. 1" in text


def test_html_needs_nothing_else(written: tuple[str, str]) -> None:
    html = written[1]
    assert not re.search(r"(src|href)=.(https?:|/|figures)", html)
    assert "<script" not in html
    assert "width=device-width" in html


def test_report_tables_are_rectangular(written: tuple[str, str]) -> None:
    widths: list[int] = []
    for line in written[0].splitlines():
        if not line.startswith("|"):
            widths = []
            continue
        widths.append(len(re.findall(r"(?<!\\)\|", line)))
        assert widths[-1] == widths[0], line


def test_measured_numbers_are_kept_and_found_while_they_fit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert load_measured(tmp_path) == {}
    keep_measured(tmp_path, {"x": [1.0, 2.0]}, [1, 2], 60.0)
    assert load_measured(tmp_path) == load_measured(tmp_path, [1, 2], 60.0) == {"x": [1.0, 2.0]}
    assert load_measured(tmp_path, [1, 2, 3]) == {}
    monkeypatch.setattr("meanflock.studies.paper.view.version", lambda: "other code")
    assert load_measured(tmp_path) == {}
    (tmp_path / "data" / "theory.json").write_text("{")
    with pytest.raises(BadInput, match=r"theory\.json"):
        load_measured(tmp_path)
