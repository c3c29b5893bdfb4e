"""Published results: verdicts follow from intervals, pages have the numbers; figures and report of synthetic tables."""

import json
import re
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from meanflock.results.plots import plotstyle
from meanflock.results.statistics import Estimate
from meanflock.swarm.scenario import load
from research.reproduction import claims, figures, grid, page, report
from research.reproduction.grid import COMPARED, FEDERATED, PERIODS, SIGMAS, UAVS
from research.reproduction.outcome import Outcome, above, below, within
from research.reproduction.tables import Results, View
from research.reproduction.verdict import (
    HOLDING,
    HOLDS_ANYWAY,
    NOT_REPRODUCED,
    NOT_TESTABLE,
    REPRODUCED,
    UNDECIDED,
    evaluate,
)
from tests.groundstation.conftest import every_axis
from tests.reproduction.synthetic import map_rows, results, row
from tests.sources import ROOT

RECORDS: list[dict[str, Any]] = json.loads((ROOT / "docs/results/claims.json").read_text(encoding="utf-8"))
MAP: dict[str, Any] = json.loads((ROOT / "docs/results/map.json").read_text(encoding="utf-8"))
REPRODUCTION = page.PAGE.read_text(encoding="utf-8")
SCENARIOS = ("paper", *page.OTHERS)
OF_MOST = {claim.id for claim in claims.load() if any(check.points == "most" for check in claim.check)}


def words_of(path: str) -> str:
    return " ".join((ROOT / path).read_text(encoding="utf-8").split())


def in_scenarios(record: dict[str, Any]) -> list[dict[str, Any]]:
    """The record's verdict and comparisons in each scenario."""
    return [record, *(record["scenarios"][name] for name in SCENARIOS[1:])]


def outcome_of(low: float, high: float, needs: str) -> Outcome:
    """The outcome of a finite interval beside `< 3`, `≥ 3` or `in [2, 4]`."""
    found = Estimate(low, low, high, n=9)
    if needs.startswith("in "):
        return within("", found, *map(float, needs[4:-1].split(", "))).outcome
    sign, limit = needs.split()
    return (below if sign in "<≤" else above)("", found, float(limit), strict=sign in "<>").outcome


def test_every_outcome_follows_from_its_interval() -> None:
    for record in RECORDS:
        for test in (test for found in in_scenarios(record) for test in found["tests"]):
            if None not in test["ci95"]:
                assert test["outcome"] == outcome_of(*test["ci95"], test["needs"]), (record["id"], test)


def test_every_verdict_follows_from_its_outcomes() -> None:
    for record in RECORDS:
        for found in in_scenarios(record):
            seen = {test["outcome"] for test in found["tests"]}
            if found["verdict"] == NOT_TESTABLE:
                continue
            if record["id"] in OF_MOST:  # of its points some may fail
                assert found["verdict"] not in HOLDING or Outcome.HOLDS in seen
            elif Outcome.FAILS in seen:
                assert found["verdict"] == NOT_REPRODUCED, record["id"]
            elif Outcome.UNDECIDED in seen:
                assert found["verdict"] == UNDECIDED, record["id"]
            else:
                assert found["verdict"] == HOLDS_ANYWAY.get(record["kind"], REPRODUCED), record["id"]


def test_every_record_repeats_its_claim() -> None:
    for record, claim in zip(RECORDS, (*claims.load(), *claims.own()), strict=True):
        for name in ("id", "kind", "figure", "statement", "metric", "scenario"):
            assert record[name] == getattr(claim, name)
        assert all(found["reason"].endswith(f"{claim.note.rstrip('.')}.") for found in in_scenarios(record))
        assert set(record["scenarios"]) == set(SCENARIOS[1:])


def test_the_readme_has_the_published_counts() -> None:
    counts = report.counts(RECORDS)
    assert sum(counts.values()) == 54
    readme = words_of("README.md")
    assert f"Of 54 claims of the paper {counts[REPRODUCED]} are reproduced, {page.tally(counts)}" in readme
    slow, printed = (page.counted(RECORDS, name)[REPRODUCED] for name in page.CHOSEN)
    assert (
        f"{slow} claims are reproduced in `paper-slow`, where UAVs steer slowly, {printed} in `paper-printed`" in readme
    )


def test_the_page_has_the_findings_the_table_and_the_rule_of_the_code() -> None:
    for line in (*page.findings(RECORDS, MAP), *page.table(RECORDS), report.RULE):
        assert line in REPRODUCTION


def test_the_named_scenarios_are_those_that_the_search_chose() -> None:
    assert len(MAP["settings"]) == grid.MAP_SETTINGS + len(grid.KNOWN)
    assert MAP["best"] == [", ".join(settings) for settings in grid.best_settings()]
    for name in page.CHOSEN:
        assert load(Path(f"scenarios/{name}.toml")).sha256() == load(None, MAP[name].split(", ")).sha256()
    assert load(Path("scenarios/paper-exchanged.toml")).sha256() == load(None, grid.PAPER_EXCHANGED).sha256()


FLOWN = (
    *("communication", "controllers", "federation", "leaderboard", "price-of-safety", "reproduction", "robustness"),
    "scaling",
)


@pytest.mark.parametrize("name", FLOWN)
def test_a_page_of_flights_names_the_code_that_flew_them(name: str) -> None:
    text = words_of(f"docs/{name}.md")
    assert re.search(r"[Cc]ode \d+\.\d+\.\d+\+[0-9a-f]{12}", text)


METRICS = ("energy_mean_J", "t_avg_censored_s", "phi_A_tavg", "phi_C_tavg")
CURVES = (
    *("energy_trip_mean_J", "energy_trip_std_J", "bits", "phi_A", "phi_C", "speed_mean_m_s", "speed_max_m_s"),
    *("speed_min_m_s", "distance_mean_m", "hjb_abs_mean", "hjb_abs_max", "fpk_abs_mean", "fpk_abs_max"),
)
PARTS = {"version": "0.1.0+x", "diverged": False, "all_arrived": True}


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
    paths = [  # three UAVs on straight ways to the origin
        {**where, "t_s": float(k), "uav": uav, "x_m": 150.0 - k / 2 + 3 * uav, "y_m": 100.0 - k / 3, "status": 0}
        | {"vx_m_s": -0.5, "vy_m_s": 0.1 * uav}
        for where, k, uav in product(traced, range(301), range(3))
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
        trajectories=pa.Table.from_pylist(paths),
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
    for k in range(1, 55):
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
