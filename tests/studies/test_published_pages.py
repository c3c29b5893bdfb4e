"""The published pages of studies: their tables, flights flown again, and the numbers of their findings."""

from collections import Counter

import numpy as np
import pytest

from meanflock.studies import communication, federation, free_flights, published
from meanflock.studies.study import summarised
from meanflock.swarm.scenario import load

CODE, FLIGHTS = published.read_rows(federation.RESULTS)
PAGE = federation.PAGE.read_text(encoding="utf-8")
QUIET = "neighbours, 0.03, int8"


def column(name: str, *case: str) -> list[float]:
    return [one[name] for one in FLIGHTS if (one["table"], one["where"], one["way"]) == case]


def total(name: str, *case: str) -> float:
    return sum(column(name, *case))


def test_every_case_has_its_flights_and_the_page_its_tables() -> None:
    assert [(one["table"], one["where"], one["way"]) for one in FLIGHTS] == [
        case for case in federation.cases() for _ in federation.SEEDS
    ]
    assert all("\n".join(lines) in PAGE for lines in federation.tables(FLIGHTS).values())
    assert CODE in PAGE
    assert f"{len(FLIGHTS):,} flights" in PAGE


def share(name: str, where: str) -> float:
    """A total with 8-bit weights among neighbours beside that with a leader."""
    return total(name, "calm", where, QUIET) / total(name, "calm", where, "leader")


def test_the_findings_in_words_are_those_of_the_flights() -> None:
    """Numbers in sentences: tests/test_prose.py."""
    for where in federation.CALM:
        quiet, leader = (np.array(column("tracking", "calm", where, way)) for way in (QUIET, "leader"))
        assert np.exp(np.log(quiet / leader).mean()) < (0.6 if where == "lossy" else 1.045)
        for name in ("t_avg_censored_s", "energy_mean_J"):
            assert share(name, where) == pytest.approx(1.0, abs=2e-3)
    assert total("uploads_late", "late", "unknown", "leader") == 0
    assert total("uploads_late", "late", "unknown", "leader, deadline 1.5 s") > 0
    assert total("arrived", "trouble", "a fifth of the uploads has the wrong sign", "neighbours") == 0


_, ROWS = published.read_rows(free_flights.RESULTS)


def test_every_case_has_a_flight_with_its_own_seed_and_the_page_their_table() -> None:
    flown = [(row["method"], row["uavs"], row["sigma"], row["outage_percent"], row["seed"]) for row in ROWS]
    assert flown == list(free_flights.cases())
    assert len({row["seed"] for row in ROWS}) == len(ROWS)
    assert Counter(row["method"] for row in ROWS) == {"plan": 300, "fed-lspi": 100}
    page = free_flights.PAGE.read_text(encoding="utf-8")
    assert "\n".join(["", *free_flights.table(ROWS), ""]) in page
    assert max(row["kbit"] for row in ROWS if row["method"] == "fed-lspi") < 300.0  # as the page says
    crashed = [dict(row, collisions_all=1) if row["seed"] == free_flights.FIRST_SEED else row for row in ROWS]
    assert "| 24 of 25 (" in free_flights.table(crashed)[2]


def test_repeated_flights_have_the_published_numbers() -> None:
    case, seed = ("calm", "lossy", QUIET), federation.SEEDS[3]
    shared = federation.flight_of(case, seed, summarised(federation.scenario(case, seed)))
    case = ("fed-lspi", 25, 0.1, 0.03, 9301)
    filtered = free_flights.row_of(case, summarised(free_flights.case_scenario(*case)))
    for again, rows in ((shared, FLIGHTS), (filtered, ROWS)):
        names = [name for name in ("table", "where", "way", "method", "uavs", "sigma", "seed") if name in again]
        (row,) = (one for one in rows if all(one[name] == again[name] for name in names))
        assert again.pop("kbit_by_kind", None) == pytest.approx(row.get("kbit_by_kind"))
        assert again == pytest.approx({name: row[name] for name in again})


COMMUNICATION = communication.PAGE.read_text(encoding="utf-8")


def test_the_page_has_the_distances_of_the_rounding_study() -> None:
    flights = [load(None, communication.CLEAR, method="mfgfl-h", seed=seed) for seed in communication.ROUNDING_SEEDS]
    _, _, *rows = communication.rounding({"mfgfl-h": [communication.measure_rounding(flown) for flown in flights]})
    assert len(rows) == 4
    assert all(f"\n{row}\n" in COMMUNICATION for row in rows)


def test_only_float64_changes_travel_time_or_energy() -> None:
    """Beside float32 of the same method, the intervals of all rows but one overlap."""
    table = COMMUNICATION.partition("<!-- flights -->")[2].partition("<!-- end -->")[0]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines() if "`" in line]
    usual = {row[0]: row for row in rows if row[1] == "float32"}
    apart = []
    for row in rows:
        for column in (5, 6):  # travel time, energy
            (mean, width), (other, its_width) = (map(float, each[column].split(" ± ")) for each in (row, usual[row[0]]))
            if abs(mean - other) > width + its_width:
                apart.append((row[0], row[1], row[column], usual[row[0]][column]))
    ((method, payload, wide, narrow),) = apart
    assert (method, payload) == ("`mfgfl-hf`", "float64")
    assert f"{wide} J where float32 takes {narrow} J" in " ".join(COMMUNICATION.split())
