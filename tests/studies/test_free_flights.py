"""The published flights behind the filter: all that were asked for, and the page says what they say."""

from collections import Counter

import pytest

from meanflock.studies import free_flights, published
from meanflock.studies.study import summarised


@pytest.fixture(scope="module")
def rows():
    return published.read_rows(free_flights.RESULTS)


def test_every_case_was_flown_each_flight_with_a_seed_of_its_own(rows) -> None:
    flown = [(row["method"], row["uavs"], row["sigma"], row["outage_percent"], row["seed"]) for row in rows]
    assert flown == list(free_flights.cases())
    assert len({row["seed"] for row in rows}) == len(rows)
    assert Counter(row["method"] for row in rows) == {"plan": 300, "fed-lspi": 100}


def test_the_table_is_that_of_the_flights(rows) -> None:
    page = free_flights.PAGE.read_text(encoding="utf-8")
    assert "\n".join(["", *free_flights.table(rows), ""]) in page


def test_what_the_page_promises_of_bits_holds(rows) -> None:
    assert max(row["kbit"] for row in rows if row["method"] == "fed-lspi") < 200.0


@pytest.mark.parametrize("case", [("plan", 25, 0.5, 50.0, 9126), ("fed-lspi", 25, 0.1, 0.03, 9301)])
def test_a_flight_is_as_published(rows, case) -> None:
    again = free_flights.row_of(case, summarised(free_flights.case_scenario(*case)))
    (published,) = [row for row in rows if all(row[name] == again[name] for name in list(again)[:5])]
    assert again == pytest.approx(published)


def test_a_collision_would_be_counted(rows) -> None:
    crashed = [dict(row, collisions_all=1) if row["seed"] == free_flights.FIRST_SEED else row for row in rows]
    assert "| 24 of 25 (" in free_flights.table(crashed)[2]
