"""The published study: every verdict follows from its intervals, and README and documentation say the same counts."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

from meanflock.studies.paper import claims, search
from meanflock.studies.paper.outcome import Outcome
from meanflock.studies.paper.report import claims as report_claims
from meanflock.studies.paper.report import write
from meanflock.studies.paper.verdict import (
    BY_CONSTRUCTION,
    HOLDING,
    HOLDS_ANYWAY,
    NOT_REFUTED,
    NOT_REPRODUCED,
    NOT_TESTABLE,
    REPRODUCED,
    UNDECIDED,
)
from meanflock.swarm.scenario import load
from tests.pages import script_of

ROOT = Path(__file__).parents[2]


reproduction = script_of("reproduction")
RECORDS: list[dict[str, Any]] = json.loads((ROOT / "docs/results/claims.json").read_text(encoding="utf-8"))
MAP: dict[str, Any] = json.loads((ROOT / "docs/results/map.json").read_text(encoding="utf-8"))
REPRODUCTION = (ROOT / "docs/reproduction.md").read_text(encoding="utf-8")
SCENARIOS = ("paper", "paper-slow", "paper-printed")
OF_MOST = {claim.id for claim in claims.load() if any(check.points == "most" for check in claim.check)}


def judged(low: float, high: float, needs: str) -> Outcome:
    """What a finite interval says of `< 3`, `≥ 3` or `in [2, 4]`."""
    if needs.startswith("in "):
        floor, ceiling = map(float, needs[4:-1].split(", "))
        inside, outside = floor <= low and high <= ceiling, low > ceiling or high < floor
    else:
        sign, limit = needs.split()[0], float(needs.split()[1])
        if sign in "<≤":
            low, high, limit = -high, -low, -limit
        inside = low > limit if sign in "<>" else low >= limit
        outside = high <= limit if sign in "<>" else high < limit
    return Outcome.HOLDS if inside else Outcome.FAILS if outside else Outcome.UNDECIDED


def of_scenarios(record: dict[str, Any]) -> list[dict[str, Any]]:
    """The record's verdict and comparisons in each scenario."""
    return [record, *(record["scenarios"][name] for name in SCENARIOS[1:])]


def test_every_comparison_has_the_outcome_its_interval_says() -> None:
    for record in RECORDS:
        for found in of_scenarios(record):
            for test in found["tests"]:
                if None not in test["ci95"]:
                    assert test["outcome"] == judged(*test["ci95"], test["needs"]), (record["id"], test)


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: record["id"])
def test_a_claim_fails_where_a_comparison_fails_and_is_undecided_where_none_does(record: dict[str, Any]) -> None:
    for found in of_scenarios(record):
        seen = {test["outcome"] for test in found["tests"]}
        if found["verdict"] == NOT_TESTABLE:
            continue
        if record["id"] in OF_MOST:  # of its points some may fail
            assert found["verdict"] not in HOLDING or Outcome.HOLDS in seen
        elif Outcome.FAILS in seen:
            assert found["verdict"] == NOT_REPRODUCED
        elif Outcome.UNDECIDED in seen:
            assert found["verdict"] == UNDECIDED
        else:
            assert found["verdict"] == HOLDS_ANYWAY.get(record["kind"], REPRODUCED)


DECIDED = {  # claims whose check can hardly fail, or that were read in two ways; with our own beside them
    "C2": (UNDECIDED, REPRODUCED, REPRODUCED),
    "C24": (REPRODUCED, NOT_REPRODUCED, REPRODUCED),
    "C25": (BY_CONSTRUCTION, BY_CONSTRUCTION, UNDECIDED),
    "C29": (BY_CONSTRUCTION, BY_CONSTRUCTION, BY_CONSTRUCTION),
    "C38": (BY_CONSTRUCTION, BY_CONSTRUCTION, BY_CONSTRUCTION),
    "C47": (NOT_REFUTED, NOT_REFUTED, NOT_REFUTED),
    "C48": (NOT_REFUTED, NOT_REFUTED, NOT_REFUTED),
    "C50": (NOT_REFUTED, NOT_REFUTED, NOT_REFUTED),
    "O6": (REPRODUCED, REPRODUCED, REPRODUCED),
    "O7": (REPRODUCED, REPRODUCED, REPRODUCED),
    "O8": (NOT_REPRODUCED, NOT_REPRODUCED, NOT_REPRODUCED),
    "O9": (NOT_REPRODUCED, NOT_REPRODUCED, NOT_REPRODUCED),
}


def test_verdicts_are_those_decided_and_say_what_they_rest_on() -> None:
    by_id = {record["id"]: record for record in RECORDS}
    for name, verdicts in DECIDED.items():
        assert tuple(found["verdict"] for found in of_scenarios(by_id[name])) == verdicts, name
    slow = by_id["C2"]["scenarios"]["paper-slow"]
    assert "of the UAVs of mfgfl-f never arrive" in slow["reason"]
    assert slow["value"]["never_arrived, mfgfl-f"] > 0.1
    end = next(test for test in by_id["O9"]["scenarios"]["paper-slow"]["tests"] if test["what"].endswith("− mfgfl-h"))
    assert end["outcome"] != Outcome.HOLDS  # so the page says that it costs no less


def test_readme_and_documentation_say_the_counts_that_were_found() -> None:
    counts = write.counts(RECORDS)
    assert sum(counts.values()) == 53
    readme = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    assert f"Of 53 claims of the paper {counts[REPRODUCED]} are reproduced, {reproduction.tally(counts)}" in readme
    slow, printed = (reproduction.counted(RECORDS, name)[REPRODUCED] for name in SCENARIOS[1:])
    assert f"{slow} claims are reproduced in `paper-slow`, where UAVs steer slowly, and {printed} in" in readme


@pytest.mark.parametrize("page", ["communication", "controllers", "leaderboard", "reproduction", "robustness"])
def test_pages_of_flights_name_the_code_that_flew_them(page: str) -> None:
    text = " ".join((ROOT / f"docs/{page}.md").read_text(encoding="utf-8").split())
    assert re.search(r"[Cc]ode 0\.1\.0\+[0-9a-f]{12}", text)
    assert ("at ticks only" in text) == (page != "communication")  # which counts no collisions
    assert "round void" in text or page in ("controllers", "robustness")


def test_only_one_width_of_a_model_shows_in_travel_time_or_energy() -> None:
    """Interval by interval: every row of communication.md beside float32 of the same method."""
    text = (ROOT / "docs/communication.md").read_text(encoding="utf-8")
    table = text.partition("<!-- flights -->")[2].partition("<!-- end -->")[0]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines() if "`" in line]
    usual = {row[0]: row for row in rows if row[1] == "float32"}
    apart = []
    for row in rows:
        for column in (5, 6):  # travel time, energy
            (mean, width), (other, its_width) = (map(float, each[column].split(" ± ")) for each in (row, usual[row[0]]))
            if abs(mean - other) > width + its_width:
                apart.append((row[0], row[1], row[column], usual[row[0]][column]))
    assert [found[:2] for found in apart] == [("`mfgfl-hf`", "float64")]
    ((_, _, wide, narrow),) = apart
    assert f"{wide} J where float32 takes {narrow} J" in " ".join(text.split())


@pytest.mark.parametrize("line", reproduction.findings(RECORDS, MAP), ids=lambda line: line[4:24])
def test_every_number_of_the_findings_is_in_the_results(line: str) -> None:
    assert line in REPRODUCTION


def test_the_numbers_said_beside_them_are_those_of_the_search() -> None:
    assert len(MAP["settings"]) == search.SETTINGS + len(search.KNOWN)
    assert "covers L_r 100…3000 m and L_v 10…150 m/s" in REPRODUCTION
    assert MAP["best"] == [", ".join(settings) for settings in search.best()]
    for name in ("paper-slow", "paper-printed"):
        chosen = load(Path(f"scenarios/{name}.toml"))
        assert chosen.sha256() == load(None, MAP[name].split(", ")).sha256()


def test_the_table_and_the_rule_are_those_of_the_code() -> None:
    for row in reproduction.table(RECORDS):
        assert row in REPRODUCTION
    assert report_claims.RULE in REPRODUCTION


def test_what_stands_in_a_record_is_what_the_claim_says() -> None:
    for record, claim in zip(RECORDS, (*claims.load(), *claims.own()), strict=True):
        for name in ("id", "kind", "figure", "statement", "metric", "scenario"):
            assert record[name] == getattr(claim, name)
        assert all(found["reason"].endswith(f"{claim.note.rstrip('.')}.") for found in of_scenarios(record))
        assert (record["single_flights"] is None) or record["single_flights"][0] <= record["single_flights"][1]
        assert set(record["scenarios"]) == {"paper-slow", "paper-printed"}
