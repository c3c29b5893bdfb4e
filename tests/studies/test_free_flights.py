"""The published flights behind the filter: their results, their table, and two of them flown again."""

from collections import Counter

import pytest

from meanflock.studies import free_flights, published
from meanflock.studies.study import summarised

ROWS = published.read_rows(free_flights.RESULTS)


def test_every_case_has_a_flight_with_its_own_seed() -> None:
    flown = [(row["method"], row["uavs"], row["sigma"], row["outage_percent"], row["seed"]) for row in ROWS]
    assert flown == list(free_flights.cases())
    assert len({row["seed"] for row in ROWS}) == len(ROWS)
    assert Counter(row["method"] for row in ROWS) == {"plan": 300, "fed-lspi": 100}


def test_the_page_has_the_table_of_the_flights() -> None:
    page = free_flights.PAGE.read_text(encoding="utf-8")
    assert "\n".join(["", *free_flights.table(ROWS), ""]) in page
    assert max(row["kbit"] for row in ROWS if row["method"] == "fed-lspi") < 300.0  # as the page says


def test_the_table_counts_a_flight_with_collisions() -> None:
    crashed = [dict(row, collisions_all=1) if row["seed"] == free_flights.FIRST_SEED else row for row in ROWS]
    assert "| 24 of 25 (" in free_flights.table(crashed)[2]


@pytest.mark.parametrize("case", [("plan", 25, 0.5, 50.0, 9126), ("fed-lspi", 25, 0.1, 0.03, 9301)])
def test_a_repeated_flight_has_the_published_numbers(case) -> None:
    again = free_flights.row_of(case, summarised(free_flights.case_scenario(*case)))
    (row,) = [row for row in ROWS if all(row[name] == again[name] for name in list(again)[:5])]
    assert again == pytest.approx(row)
