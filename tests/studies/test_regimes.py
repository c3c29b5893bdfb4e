"""Single flights, the score of a setting, and the rule by which scenarios are chosen, on runs with known answers."""

import numpy as np
import pytest

from meanflock.studies.paper import claims, grid, regimes, search
from meanflock.studies.paper.single import has_single_flights, single_flights
from meanflock.studies.paper.view import View
from meanflock.swarm.scenario import load
from tests.studies.map_rows import SETTINGS, map_rows
from tests.studies.synthetic import results, row

CLAIMS = {claim.id: claim for claim in claims.load()}


def test_a_claim_that_fails_on_average_may_hold_in_single_flights() -> None:
    """HF's energy is .8, .9 and .8 of the others': at most .84 in two of three flights."""
    levels = {1: 0.8, 2: 0.9, 3: 0.8}
    runs = [
        row("s0", method, seed, energy_mean_J=level if method == "mfgfl-hf" else 1.0)
        for method in ("hjb", "mfgfl-h", "mfgfl-f", "mfgfl-hf")
        for seed, level in levels.items()
    ]
    view = View.of(results(runs))
    assert single_flights(view, CLAIMS["C13"]) == (2, 3)
    assert single_flights(view, CLAIMS["C8"]) is None  # nothing is known of collisions


def test_a_flight_that_lacks_a_method_is_not_counted() -> None:
    runs = [row("s0", m, 1, energy_mean_J=0.5 if m == "mfgfl-hf" else 1.0) for m in ("hjb", "mfgfl-h", "mfgfl-hf")]
    assert single_flights(View.of(results(runs)), CLAIMS["C13"]) is None


def test_claims_of_grids_and_of_the_theory_have_no_single_flights() -> None:
    assert [has_single_flights(CLAIMS[name]) for name in ("C1", "C7", "C26", "C47", "C53")] == [False] * 5
    assert all(has_single_flights(CLAIMS[name]) for name in ("C8", "C10", "C13", "C16", "C21"))


@pytest.fixture(scope="module")
def places() -> list[regimes.Place]:
    return regimes.places(View.of(results(map_rows())))


def test_a_setting_scores_what_holds_in_its_flights(places: list[regimes.Place]) -> None:
    default, slow, *_ = places
    assert [place.setting for place in places] == list(SETTINGS)
    assert default.held["C13"] == (0, 2)
    assert slow.held["C13"] == (2, 2)
    assert slow.held["C8"] == (1, 2)  # HF is free of collisions in one
    assert slow.held["C9"] == (1, 2)  # and in the other has as many as H
    assert slow.held["C19"] == (0, 2)  # whose metric no flight has
    assert slow.score == pytest.approx(sum(k / n for k, n in slow.held.values()))
    assert slow.score == default.score + 1
    assert not {"C3", "C14", "C24", "C25", "C18"} & set(slow.held)  # bits, residuals, and what was calibrated


def test_the_rule_chooses_by_score_among_what_it_allows(places: list[regimes.Place]) -> None:
    assert regimes.slow(places).setting == SETTINGS[1]  # the third has other rounds, in the last nobody arrives
    assert regimes.printed(places).setting == SETTINGS[3]
    assert SETTINGS[4] not in [place.setting for place in regimes.best(places)]
    assert [place.setting for place in regimes.best(places, 2)] == [SETTINGS[1], SETTINGS[2]]


def test_the_design_is_the_same_every_time_and_fills_its_ranges() -> None:
    design = search.design()
    assert design == search.design()
    assert len(set(design)) == len(design) == search.SETTINGS + len(search.KNOWN)
    drawn = [load(None, settings).learner for settings in design[len(search.KNOWN) :]]
    for name, (low, high) in (("position_scale", (100, 3000)), ("velocity_scale", (10, 150)), ("c_h", (0.05, 5))):
        values = np.sort([getattr(learner, name) for learner in drawn])
        assert low <= values[0] < low * 1.1
        assert high / 1.1 < values[-1] <= high
    kappa = np.array([learner.kappa for learner in drawn])
    assert np.mean(kappa == 0.0) == pytest.approx(1 / 6, abs=0.02)
    assert kappa.max() <= 0.2
    assert sum(learner.multinomial for learner in drawn) == search.SETTINGS // 2


def test_the_map_and_what_it_found_have_seeds_of_their_own() -> None:
    of: dict[str, set[int]] = {}
    for run in grid.wanted(2):
        of.setdefault(run.point.experiment, set()).add(run.seed)
    assert of["map"] == {6001, 6002}
    assert of["found"] == {7001, 7002}
    assert max(max(seeds) for name, seeds in of.items() if name not in ("map", "found")) < 6000
