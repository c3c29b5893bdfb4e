"""The published pages of studies: their tables, flights flown again, and the numbers of their findings."""

import math
from collections import Counter
from collections.abc import Iterator
from itertools import product
from typing import Any

import numpy as np
import pytest

from meanflock.results import statistics
from meanflock.studies import equal_bits, published
from meanflock.studies.equal_bits import Choice
from meanflock.studies.frontier import record
from meanflock.studies.frontier.page import page
from meanflock.studies.frontier.search import FlightOutcome
from meanflock.studies.study import summarised
from meanflock.swarm.scenario import load
from research import communication, false_states, federation, free_flights, robustness

_, FEDERATED = published.read_rows(federation.RESULTS)
QUIET = "neighbours, 0.03, int8"


def column(name: str, *case: str) -> np.ndarray:
    """A number of the flights of a table, mission and way of the page about federations."""
    rows = [row for row in FEDERATED if (row["table"], row["where"], row["way"]) == case]
    return np.array([row[name] for row in rows], dtype=np.float64)


def test_every_case_has_its_flights() -> None:
    flown = [(one["table"], one["where"], one["way"]) for one in FEDERATED if one["table"] != "digits"]
    assert flown == [case for case in federation.cases() for _ in federation.SEEDS]


def test_the_findings_in_words_are_those_of_the_flights() -> None:
    for where in federation.CALM:
        tracking = (np.log(column("tracking", "calm", where, way)) for way in (QUIET, "leader"))
        assert statistics.difference(*tracking).value < math.log(0.6 if where == "lossy" else 1.06)
        for name in ("t_avg_censored_s", "energy_mean_J"):
            sums = [column(name, "calm", where, way).sum() for way in (QUIET, "leader")]
            assert sums[0] == pytest.approx(sums[1], rel=2e-3)
    assert not column("uploads_late", "late", "unknown", "leader").any()
    assert column("uploads_late", "late", "unknown", "leader, deadline 1.5 s").any()
    assert not column("arrived", "trouble", "a fifth of the uploads has the wrong sign", "neighbours").any()


@pytest.mark.parametrize(
    "study", [equal_bits, false_states, federation, free_flights, robustness], ids=lambda study: study.__name__
)
def test_a_page_has_the_tables_of_its_results(study: Any) -> None:
    text = study.PAGE.read_text(encoding="utf-8")
    assert study.page(text, *published.read_rows(study.RESULTS)) == text


def test_the_page_on_the_price_of_safety_is_that_of_its_records() -> None:
    found = record.read(published.DOCS / "results" / record.FILE)
    expected = equal_bits.page(page(found), *published.read_rows(equal_bits.RESULTS))
    assert equal_bits.PAGE.read_text(encoding="utf-8") == expected, "run `python -m meanflock.studies.frontier --page`"


def test_a_false_velocity_harms_exactly_if_it_is_accepted_and_impossible() -> None:
    _, rows = published.read_rows(false_states.RESULTS)
    arrived = {name: [row["arrived"] for row in rows if row["case"] == name] for name in false_states.CASES}
    assert {name for name, flights in arrived.items() if min(flights) < 25} == {"10⁶ m/s, accepted"}
    assert set(arrived["10⁶ m/s, accepted"]) == {1}
    times = {name: np.array([row["t_avg_s"] for row in rows if row["case"] == name]) for name in arrived}
    assert statistics.difference(times["true"], times["99 m/s, accepted"]).low > 0.0  # the others are faster
    again = false_states.flight("10⁶ m/s, rejected", false_states.FIRST_SEED)
    assert again | {"case": "10⁶ m/s, rejected"} in rows


def of_seeds(first: int, second: int) -> dict[str, list[Any]]:
    """A row of the ranking with so many free flights of the first and of the second seeds."""
    free = [k < count for count in (first, second) for k in range(30)]
    return {"free": free, "kbit": [float(first)] * 60, "arrived": [1.0] * 60}


def test_a_ranking_is_of_the_first_seeds_and_the_second_ones_test_it() -> None:
    place = {"mission": "lossy", "budget_kbit": 2.0, "policy": "event"}
    rows = [
        place | {"controller": name} | of_seeds(*counts)
        for name, counts in {"bvc": (2, 25), "orca": (28, 20), "vasarhelyi": (30, 30)}.items()
    ]
    rows.append(place | {"controller": "potential-field", "policy": equal_bits.NONE, "free": [], "kbit": []})
    ranked = equal_bits.rank(rows, "lossy", 2.0)
    assert [row["controller"] for row in ranked] == ["vasarhelyi", "orca", "bvc", "potential-field"]
    every, _, first, *_ = equal_bits.findings(rows)
    assert every == "**Of 2 differences, 1 have the same sign on the second seeds.**"
    assert first.endswith("`vasarhelyi` above `bvc`; `orca` above `bvc` (1 of 2 agree).")


def test_a_choice_is_the_safest_policy_within_the_budget_and_leaves_no_uav_behind() -> None:
    def flights(free: int, kbit: float, arrived: float = 1.0) -> list[FlightOutcome]:
        return [FlightOutcome(k < free, kbit, arrived) for k in range(10)]

    found = {
        Choice("lossy", "orca", "cheap"): flights(8, 20.0),
        Choice("lossy", "orca", "equal"): flights(8, 30.0),
        Choice("lossy", "orca", "leaves some"): flights(10, 30.0, arrived=0.9),
        Choice("lossy", "orca", "dear"): flights(10, 90.0),
        Choice("lossy", "bvc", "another"): flights(10, 1.0),
    }
    chosen = [equal_bits.chosen(found, "lossy", budget, "orca") for budget in (2.0, 4.0)]  # of 25 UAVs
    assert [each and each.policy for each in chosen] == ["cheap", "dear"]
    assert equal_bits.chosen(found, "lossy", 0.5, "orca") is None


_, ROWS = published.read_rows(free_flights.RESULTS)


def test_every_case_has_a_flight_with_its_own_seed() -> None:
    flown = [(row["method"], row["uavs"], row["sigma"], row["outage_percent"], row["seed"]) for row in ROWS]
    assert flown == list(free_flights.cases())
    assert len({row["seed"] for row in ROWS}) == len(ROWS)
    assert Counter(row["method"] for row in ROWS) == {"plan": 300, "fed-lspi": 100}
    crashed = [dict(row, collisions_all=1) if row["seed"] == free_flights.FIRST_SEED else row for row in ROWS]
    assert "| 24 of 25 (" in free_flights.table(crashed)[2]


def test_repeated_flights_have_the_published_numbers() -> None:
    case, seed = ("calm", "lossy", QUIET), federation.SEEDS[3]
    shared = federation.flight_of(case, seed, summarised(federation.scenario(case, seed)))
    case = ("fed-lspi", 25, 0.1, 0.03, 109301)
    filtered = free_flights.row_of(case, summarised(free_flights.case_scenario(*case)))
    for again, rows in ((shared, FEDERATED), (filtered, ROWS)):
        names = [name for name in ("table", "where", "way", "method", "uavs", "sigma", "seed") if name in again]
        (row,) = (one for one in rows if all(one[name] == again[name] for name in names))
        assert again.pop("kbit_by_kind", None) == pytest.approx(row.get("kbit_by_kind"))
        assert again == pytest.approx({name: row[name] for name in again})


def test_the_page_has_the_distances_of_the_rounding_study() -> None:
    flights = [load(None, communication.CLEAR, method="mfgfl-h", seed=seed) for seed in communication.ROUNDING_SEEDS]
    measured = {"mfgfl-h": [communication.measure_rounding(flown) for flown in flights]}
    rows = communication.rounding(measured)[2:] + communication.rejected(measured)[2:]
    assert len(rows) == 4 + 3
    assert all(f"\n{row}\n" in communication.PAGE.read_text(encoding="utf-8") for row in rows)


def rows_after(mark: str, text: str) -> Iterator[dict[str, str]]:
    """Rows of the table that a study wrote after a mark."""
    table = text.partition(f"<!-- {mark} -->")[2].partition("<!-- end")[0]
    head, _, *lines = (line for line in table.splitlines() if line.startswith("|"))
    names, *rows = ([cell.strip() for cell in line.strip("|").split("|")] for line in (head, *lines))
    for row in rows:
        yield dict(zip(names, row, strict=True))


def test_only_float64_changes_travel_time_or_energy() -> None:
    """Beside float32 of the same method, the intervals of all rows but one overlap."""
    rows = list(rows_after("flights", communication.PAGE.read_text(encoding="utf-8")))
    usual = {row["method"]: row for row in rows if row["payload"] == "float32"}
    apart = []
    for row, name in product(rows, ("travel time, s", "energy until own arrival, J")):
        (mean, width), (other, its_width) = (map(float, one[name].split(" ± ")) for one in (row, usual[row["method"]]))
        if abs(mean - other) > width + its_width:
            apart.append((row["method"], row["payload"]))
    assert apart == [("`mfgfl-hf`", "float64")]
