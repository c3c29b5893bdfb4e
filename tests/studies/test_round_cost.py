"""The page on the cost of a round, and the comparisons in one band: their tables, findings, and flights flown again."""

from typing import Any

import pytest

from meanflock.studies import published
from research import one_band
from research.round_cost import flights, page
from research.round_cost.flights import CLUSTER, CONTENTION, LOSSY, OWN, SHARED, Cell

_, ROWS = published.read_rows(page.RESULTS)
CELLS = page.by_cell(ROWS)
_, IN_ONE_BAND = published.read_rows(one_band.RESULTS)
SEEDS = len({row["seed"] for row in IN_ONE_BAND})
PRESETS = ("radio-sky", "radio-thin")


def mean(name: str, way: str, radio: str, access: str) -> float:
    """A number of the classifier's rounds, mean of the flights."""
    rows = CELLS[Cell("classifier", radio, way, access)]
    return float(sum(row[name] for row in rows) / len(rows))


def test_every_cell_has_its_seeds() -> None:
    assert {cell: [row["seed"] for row in rows] for cell, rows in CELLS.items()} == {
        cell: list(flights.seeds(cell)) for cell in flights.cells()
    }


def test_the_pages_have_the_tables_of_their_results() -> None:
    text = page.PAGE.read_text(encoding="utf-8")
    assert page.page(text, *published.read_rows(page.RESULTS)) == text
    for path in one_band.PAGES.values():
        text = path.read_text(encoding="utf-8")
        assert one_band.page(text, *published.read_rows(one_band.RESULTS)) == text


def test_the_ranking_depends_on_the_spectrum_only_if_slots_are_lost() -> None:
    def verdicts(radio: str) -> list[str]:
        advantages = (of(CELLS, radio, access) for of in (page.gain, page.tracking_saved) for access in (OWN, SHARED))
        return list(map(page.verdict, advantages))

    assert verdicts("20 % of slots lost") == ["undecided", "leader", "undecided", "leader"]
    assert verdicts("36 % of slots lost") == ["neighbours", "neighbours", "undecided", "leader"]
    assert "leader" not in verdicts("radio-sky") + verdicts("radio-thin")


def test_the_findings_in_words_are_those_of_the_flights() -> None:
    for radio in PRESETS:
        times = [
            mean("band_time_MHz_s", way, radio, OWN) / mean("band_time_MHz_s", way, radio, SHARED)
            for way in ("neighbours", "leader")
        ]
        assert times == pytest.approx([24.0, 1.92], rel=0.01)
        assert mean("radio_J", "neighbours", radio, SHARED) / mean("radio_J", "leader", radio, SHARED) > 7.9
        assert mean("lost_share", "neighbours", radio, CONTENTION) > 0.75
        assert 1.9 < mean("round_s", "leader", radio, CONTENTION) / mean("round_s", "leader", radio, SHARED) < 2.2
    for way in ("leader", "clusters", "neighbours", "station"):
        costs = [mean("accuracy", way, radio, OWN) - mean("accuracy", way, radio, SHARED) for radio in PRESETS]
        assert costs[0] < 0.01
        assert 0.07 < costs[1] < 0.091
    for radio in ("radio-thin", *LOSSY):
        ways = [mean("accuracy", way, radio, SHARED) for way in ("leader", "clusters", "neighbours", "station")]
        assert mean("accuracy", "clusters", radio, CLUSTER) > max(ways)
        assert 2.5 < mean("round_s", "clusters", radio, SHARED) / mean("round_s", "clusters", radio, CLUSTER) < 3.1
    planned = [row for row in ROWS if row["method"] == "fed-lspi"]
    assert all(row["arrived"] == row["uavs"] for row in planned)
    assert max(row["round_s"] for row in planned if row["radio"] not in LOSSY) == pytest.approx(0.3)
    tracked = {tuple(row[name] for name in ("radio", "way", "access", "seed")): row["tracking"] for row in planned}
    assert all(
        cost == tracked[radio, way, SHARED, seed]
        for (radio, way, access, seed), cost in tracked.items()
        if access == OWN and radio not in LOSSY
    )


@pytest.mark.parametrize("radio", ["radio-mast", "radio-street"])
def test_between_uavs_these_radios_are_as_good_as_radio_sky(radio: str) -> None:
    (flown,) = flights.flights(Cell("fed-lspi", radio, "neighbours", SHARED), [flights.FIRST_SEED])
    again = flights.measure(flown)
    published_row = CELLS[Cell("fed-lspi", "radio-sky", "neighbours", SHARED)][0]
    assert again == pytest.approx({name: published_row[name] for name in again})


def test_repeated_flights_have_the_published_numbers() -> None:
    cell = Cell("classifier", "radio-thin", "leader", SHARED)
    (flown,) = flights.flights(cell, [flights.FIRST_SEED])
    again = flights.measure(flown)
    assert again == pytest.approx({name: CELLS[cell][0][name] for name in again})


def test_one_band_changes_no_flight_over_the_radio_of_the_paper() -> None:
    assert [tuple(row[name] for name in ("table", "mission", "name", "bands")) for row in IN_ONE_BAND[::SEEDS]] == (
        one_band.cases()
    )
    flown: dict[Any, set[str]] = {}
    for row in IN_ONE_BAND:
        case = row["table"], row["mission"], row["name"], row["seed"]
        flown.setdefault(case, set()).add(row["trajectory_sha256"])
    assert {len(trajectories) for trajectories in flown.values()} == {1}
