"""The page of ways to share a model: its tables, flights flown again, and the numbers of its findings."""

import numpy as np
import pytest

from meanflock.studies import federation, published
from meanflock.studies.study import summarised

CODE, *FLIGHTS = published.read_rows(federation.RESULTS)
PAGE = federation.PAGE.read_text(encoding="utf-8")
WORDS = " ".join(PAGE.split())
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
    assert CODE["code"] in PAGE
    assert f"{len(FLIGHTS):,} flights" in PAGE


@pytest.mark.parametrize("case", [("calm", "lossy", QUIET), ("sparing", "paper", "threshold 0.2")])
def test_a_repeated_flight_has_the_published_numbers(case: federation.Case) -> None:
    seed = federation.SEEDS[3]
    again = federation.flight_of(case, seed, summarised(federation.scenario(case, seed)))
    (row,) = (one for one in FLIGHTS if all(one[name] == again[name] for name in ("table", "where", "way", "seed")))
    assert again == pytest.approx(row)


def share(name: str, where: str) -> float:
    """A total with 8-bit weights among neighbours beside that with a leader."""
    return total(name, "calm", where, QUIET) / total(name, "calm", where, "leader")


def test_the_findings_have_the_numbers_of_the_flights() -> None:
    saved = [round(100 * (1 - share("kbit", where))) for where in federation.CALM]
    assert saved == [83, 80, 63, 82]
    assert (
        "83 % fewer bits of models than a leader on `paper`, 80 % on `unknown`, 63 % on `windy` and 82 % on `lossy`"
        in WORDS
    )
    assert [f"{share('airtime_s', where):.1f}" for where in federation.CALM] == ["0.8", "1.0", "1.8", "0.5"]
    for where in federation.CALM:
        quiet, leader = (np.array(column("tracking", "calm", where, way)) for way in (QUIET, "leader"))
        assert np.exp(np.log(quiet / leader).mean()) < (0.6 if where == "lossy" else 1.045)
        for name in ("t_avg_censored_s", "energy_mean_J"):
            assert share(name, where) == pytest.approx(1.0, abs=2e-3)
    late = [np.array(column("tracking", "late", "unknown", way)) for way in federation.LATE]
    ratios = [f"{np.exp(np.log(one / late[0]).mean()):.2f}" for one in late]
    assert ratios == ["1.00", "0.60", "0.61", "0.45"]
    assert total("uploads_late", "late", "unknown", "leader") == 0
    assert total("uploads_late", "late", "unknown", "leader, deadline 1.5 s") > 0
    wrong = "a fifth of the uploads has the wrong sign"
    assert [total("arrived", "trouble", wrong, way) for way in ("leader", "neighbours")] == [75, 0]
    near = ("trouble", "uploads reach 2 m", "leader")
    assert total("uavs", *near) - total("arrived", *near) == 28
