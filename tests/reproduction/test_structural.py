"""The part of the page on round lengths and readings: numbers worked by hand, and the text of the published file."""

import json
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
import pytest

from meanflock.swarm.scenario import Scenario, load
from research.reproduction import grid, page, structural, structural_page
from research.reproduction.figures import FLOWN_FOR, chosen
from research.reproduction.tables import View
from tests.reproduction.synthetic import results, row
from tests.sources import ROOT

STRUCTURAL: dict[str, Any] = json.loads((ROOT / "docs/results/structural.json").read_text(encoding="utf-8"))
RECORDS: list[dict[str, Any]] = json.loads((ROOT / "docs/results/claims.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize(("target", "expected"), [(40.0, (17.0, 8.0)), (120.0, (0.0, 0.0))])
def test_a_clear_channel_delivers_every_round_of_a_trip_and_a_dead_one_none(
    target: float, expected: tuple[float, float]
) -> None:
    radio = msgspec.structs.replace(Scenario().radio, target_snr_db=target, latency_threshold_slots=100)
    found = (structural.taken_over(radio, 108, 100), structural.taken_over(radio, 246, 200))
    assert found == pytest.approx(expected, abs=1e-9)


def test_a_model_that_needs_more_slots_than_there_are_is_never_taken_over() -> None:
    radio = msgspec.structs.replace(Scenario().radio, latency_threshold_slots=3)
    assert structural.taken_over(radio, 246, 200) == 0.0
    assert structural.taken_over(radio, 108, 100) > 10.0


def test_the_density_has_no_share_of_a_cost_without_it_and_a_growing_one_with_its_weight() -> None:
    keys = ["uavs=4", "duration=3"]
    shares = [structural.cost_share(load(None, [*keys, f"cost.c2={c2}"], method="mfg")) for c2 in (0, 0.015, 0.15)]
    assert shares[0] == 0.0
    assert 0.0 < shares[1] < shares[2] < 1.0


def test_ratios_pair_the_seeds_and_lost_models_are_told_from_lost_uploads() -> None:
    clear, fewer = "federation.period=200, radio.model=ideal", "federation.fraction=0.7"
    level = {("period", "mfgfl-h", ""): 1.0, ("period", "mfgfl-hf", ""): 1.2, ("losses", "mfgfl-h", clear): 1.0}
    level |= {("losses", "mfgfl-hf", clear): 1.0, ("losses", "mfgfl-hf", f"{clear}, {fewer}"): 1.0}
    rows = [
        row(
            experiment,
            method,
            seed,
            period=200,
            setting=setting,
            phi_A_tavg=size * (1 + seed / 100),
            broadcast_outage_rate=0.125,
        )
        for (experiment, method, setting), size in level.items()
        for seed in (1, 2, 3)
        if (experiment, seed) != ("losses", 3)
    ]
    found = structural.losses(View.from_results(results(rows)))
    assert found["with losses, HF / H"] == pytest.approx([1.2, 1.2, 1.2])
    assert found["without losses, HF / H"] == pytest.approx([1.0, 1.0, 1.0])
    assert found["HF, with losses / an eighth fewer uploads"] == pytest.approx([1.2, 1.2, 1.2])
    assert found["seeds"] == 2


def test_a_drift_is_measured_at_thirty_seconds() -> None:
    settings = [f"{grid.DRIFTING}, wind.common={share}" for share in (0.0, *grid.COMMON)]
    series = [
        row("drift", "mfg", seed, setting=setting, t_s=float(t), collisions=float(t * (k + seed)))
        for k, setting in enumerate(settings)
        for seed in (1, 3)
        for t in (29, 30, 31)
    ]
    found = structural.drift(View.from_results(results([row("drift", "mfg", 1)], series=pa.Table.from_pylist(series))))
    assert [each["collisions"][0] for each in found] == [60.0, 90.0, 120.0, 150.0]
    assert {each["seeds"] for each in found} == {2}


def test_the_page_has_the_published_numbers() -> None:
    text = page.PAGE.read_text(encoding="utf-8")
    for line in structural_page.lines(STRUCTURAL, RECORDS):
        assert line in text


def test_every_reading_was_flown_and_says_of_how_many_seeds() -> None:
    assert [each["name"] for each in STRUCTURAL["readings"]] == [name for name, _, _ in structural.READINGS]
    assert all(each["seeds"] >= 6 for each in (*STRUCTURAL["readings"], *STRUCTURAL["rounds"], *STRUCTURAL["drift"]))
    numbers = [each for each in STRUCTURAL["rounds"][0].values() if isinstance(each, list)]
    assert np.isfinite(np.array(numbers, dtype=np.float64)).all()


def test_only_exchanged_flies_its_experiments_and_draws_no_figure() -> None:
    assert chosen(["exchanged"]) == ["exchanged"]
    assert FLOWN_FOR["exchanged"] == {experiment for experiment, _, _ in grid.structural()}
