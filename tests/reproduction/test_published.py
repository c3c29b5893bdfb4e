"""The published results: verdicts follow from intervals, and README and pages have the numbers of the results."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

from meanflock.groundstation.statistics import Estimate
from meanflock.swarm.scenario import load
from reproduction import claims, grid, page, report
from reproduction.outcome import Outcome, above, below, within
from reproduction.verdict import HOLDING, HOLDS_ANYWAY, NOT_REPRODUCED, NOT_TESTABLE, REPRODUCED, UNDECIDED
from tests.sources import ROOT

RECORDS: list[dict[str, Any]] = json.loads((ROOT / "docs/results/claims.json").read_text(encoding="utf-8"))
MAP: dict[str, Any] = json.loads((ROOT / "docs/results/map.json").read_text(encoding="utf-8"))
REPRODUCTION = page.PAGE.read_text(encoding="utf-8")
SCENARIOS = ("paper", "paper-slow", "paper-printed")
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
    assert sum(counts.values()) == 53
    readme = words_of("README.md")
    assert f"Of 53 claims of the paper {counts[REPRODUCED]} are reproduced, {page.tally(counts)}" in readme
    slow, printed = (page.counted(RECORDS, name)[REPRODUCED] for name in SCENARIOS[1:])
    assert f"{slow} claims are reproduced in `paper-slow`, where UAVs steer slowly, and {printed} in" in readme


def test_the_page_has_the_findings_the_table_and_the_rule_of_the_code() -> None:
    for line in (*page.findings(RECORDS, MAP), *page.table(RECORDS), report.RULE):
        assert line in REPRODUCTION


def test_the_named_scenarios_are_those_that_the_search_chose() -> None:
    assert len(MAP["settings"]) == grid.MAP_SETTINGS + len(grid.KNOWN)
    assert MAP["best"] == [", ".join(settings) for settings in grid.best_settings()]
    for name in SCENARIOS[1:]:
        assert load(Path(f"scenarios/{name}.toml")).sha256() == load(None, MAP[name].split(", ")).sha256()


FLOWN = (
    *("communication", "controllers", "federation", "leaderboard", "price-of-safety", "reproduction", "robustness"),
    "scaling",
)


@pytest.mark.parametrize("name", FLOWN)
def test_a_page_of_flights_names_the_code_that_flew_them(name: str) -> None:
    text = words_of(f"docs/{name}.md")
    assert re.search(r"[Cc]ode \d+\.\d+\.\d+\+[0-9a-f]{12}", text)
