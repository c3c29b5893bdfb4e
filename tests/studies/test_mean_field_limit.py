"""The page on the mean-field limit: its distances in closed form, its fits, its tables, and a flight flown again."""

from typing import Any

import numpy as np
import pytest

from meanflock.launch.engine import Engine
from meanflock.launch.station import StoredTelemetry
from meanflock.results import statistics
from meanflock.results.statistics import Estimate
from meanflock.studies import published
from meanflock.swarm import state
from research.mean_field_limit import cases, fit, flights, page
from research.mean_field_limit.flights import BEGINNING, METHOD, SwarmCase

CODE, ROWS = published.read_rows(page.RESULTS)


def distance(first: np.ndarray, second: np.ndarray) -> float:
    """Sliced Wasserstein-1 distance of two sets of points."""
    return float(cases.sliced_wasserstein(flights.quantiles(first) - flights.quantiles(second)))


def test_two_sets_that_are_shifted_are_as_far_apart_as_the_mean_projection_of_the_shift() -> None:
    points = np.random.default_rng(1).normal(size=(300, 2))
    shift = np.array([3.0, -4.0])
    assert distance(points, points[::-1]) == 0.0
    # 5 m times the mean of |cos| over the half circle, 2/π; sixteen directions are within half a percent of it
    assert distance(points + shift, points) == pytest.approx(5.0 * 2.0 / np.pi, rel=5e-3)


def test_a_set_beside_one_of_twice_its_size_is_at_the_distance_of_their_scales() -> None:
    """W₁ of two projections onto a line whose quantiles are q and 2 q is the mean of |q|."""
    points = np.stack([np.linspace(-1.0, 1.0, 2_001), np.zeros(2_001)], axis=-1)
    assert distance(2.0 * points, points) == pytest.approx(0.5 * 2.0 / np.pi, rel=1e-2)


def test_samples_of_a_law_approach_it_with_the_exponent_of_the_page() -> None:
    limit = flights.quantiles(np.random.default_rng(0).normal(size=(200_000, 2)))
    rows: list[dict[str, Any]] = []
    for seed in range(12):
        draw = np.random.default_rng([seed, 1])
        for uavs in (10, 100, 1_000):
            found = cases.sliced_wasserstein(flights.quantiles(draw.normal(size=(uavs, 2))) - limit)
            rows.append({"uavs": uavs, "flight": BEGINNING, "seed": seed, "positions": [float(found)]})
    fitted = page.exponent(rows, "positions", 0)
    assert fitted.n == 12
    assert page.verdict(fitted) == "as expected"


@pytest.mark.parametrize(
    ("ends", "text"),
    [((-0.55, -0.45), "as expected"), ((-0.9, 0.1), "undecided"), ((-0.4, -0.1), "slower"), ((-0.9, -0.6), "faster")],
)
def test_a_verdict_compares_the_interval_with_the_expected_exponent(ends: tuple[float, float], text: str) -> None:
    assert page.verdict(Estimate(sum(ends) / 2, *ends, n=9)) == text


def test_an_exponent_is_that_of_the_seeds_that_flew_every_swarm() -> None:
    rows = [
        {"uavs": uavs, "flight": BEGINNING, "seed": seed, "phi_G": [0.0, (1 + seed) * uavs**-0.25]}
        for uavs in (10, 100, 1_000)
        for seed in range(3)
        if (uavs, seed) != (1_000, 2)
    ]
    fitted = page.exponent(rows, "phi_G", 1)
    assert (fitted.value, fitted.n) == (pytest.approx(-0.25), 2)


def test_all_swarms_start_in_the_same_square_and_at_other_places_for_each_seed() -> None:
    first, second = (np.array(flights.starts(4_000, seed)) for seed in (1, 2))
    assert len(np.unique(first, axis=0)) == 4_000
    assert first.min(axis=0) == pytest.approx(flights.CORNER, abs=0.5)
    assert np.ptp(first, axis=0) == pytest.approx([80.0, 80.0], abs=1.0)
    assert (first != second).any()


def test_the_cost_of_the_last_uav_is_that_of_its_path() -> None:
    flown = flights.flight(SwarmCase(6, "cruise"), 3)
    telemetry, last = StoredTelemetry(), flights.LastCost(flown)
    engine = Engine(flown, "cost", sinks=[telemetry])
    engine.add_sink(last)
    summary = engine.complete()
    ticks = round(summary["groups"]["last"]["t_avg_s"] / flown.dt)
    states = np.concatenate([block.states for block in telemetry.blocks])
    command = np.concatenate([block.accelerations for block in telemetry.blocks])[1 : ticks + 1, -1].astype(float)
    own, cost = states[:ticks, -1], flown.cost
    away = states[:ticks] - own[:, None]
    apart = cost.epsilon + (state.position(away) ** 2).sum(axis=-1)
    phi_g = ((state.velocity(away) ** 2).sum(axis=-1) / apart).mean(axis=-1)
    approach = (state.position(own) * state.velocity(own)).sum(axis=-1) / np.hypot(*state.position(own).T)
    speed = cost.c1 * (state.velocity(own) ** 2).sum(axis=-1)
    expected = flown.dt * (approach + speed + cost.c2 * phi_g + cost.c3 * (command**2).sum(axis=-1)).sum()
    assert last.cost == pytest.approx(expected, rel=1e-9)


def test_the_page_has_the_tables_of_its_results() -> None:
    text = page.PAGE.read_text(encoding="utf-8")
    assert page.page(text, CODE, ROWS) == text


def test_every_flown_case_has_its_seeds() -> None:
    flown: dict[SwarmCase, list[int]] = {}
    for row in ROWS:
        flown.setdefault(SwarmCase(row["uavs"], row["flight"]), []).append(row["seed"])
    assert flown.pop(SwarmCase(fit.UAVS, fit.FIT)) == [*fit.SEEDS[1:]] * len(fit.POINTS)
    wanted = cases.cases()
    assert all(seeds == list(wanted[case]) for case, seeds in flown.items())


def test_the_findings_in_words_are_those_of_the_flights() -> None:
    for time in range(len(flights.TIMES_S)):
        for name in cases.DISTANCES:
            assert all(page.verdict(page.exponent(ROWS, name, time, least)) == "as expected" for least in page.LARGE)
        assert page.verdict(page.exponent(ROWS, "phi_G", time, 1_000)) == "as expected"
        assert page.exponent(ROWS, "phi_G_learned", time).value > -0.1
    for uavs in page.sizes(ROWS, METHOD):
        assert page.better(page.changed(ROWS, uavs, "cruise", "last_cost_m")) == "gains"
        assert page.better(page.changed(ROWS, uavs, "mfg", "last_cost_m")) == "loses"
        assert page.better(page.changed(ROWS, uavs, "mfg", "last_energy_J")) == (
            "undecided" if uavs == 3_000 else "loses"
        )
    (reference,) = page.of(ROWS, *cases.REFERENCE)
    for uavs in (100, 300, 1_000, 3_000, 10_000):
        for name in ("energy_J", "phi_A"):
            found = statistics.mean([row[name] for row in page.of(ROWS, uavs, BEGINNING)])
            assert found.low <= reference[name] <= found.high


@pytest.mark.parametrize("case", [SwarmCase(10, BEGINNING), SwarmCase(10, METHOD), SwarmCase(10, "mfg")])
def test_repeated_flights_have_the_published_numbers(case: SwarmCase) -> None:
    (row,) = (row for row in ROWS if (*case, cases.FIRST_SEED) == (row["uavs"], row["flight"], row["seed"]))
    measured = flights.measure(flights.flight(case, cases.FIRST_SEED))
    again = cases.row_of(case, cases.FIRST_SEED, measured, measured)
    names = again.keys() - {*cases.DISTANCES, *cases.INTERACTIONS, "flight", "trajectory_sha256"}
    assert {name: again[name] for name in names} == pytest.approx({name: row[name] for name in names}, rel=1e-4)


def test_repeated_fits_have_the_published_distance() -> None:
    points = fit.POINTS[0]
    again = fit.rows_of({points: [fit.measure(scenario) for scenario in fit.fits()[points]]})
    published_rows = [row for row in ROWS if row["flight"] == fit.FIT and row["points"] == points]
    assert [row["phi_G_learned"] for row in again] == pytest.approx([row["phi_G_learned"] for row in published_rows])
