"""The published study: every verdict follows from its intervals, and README and documentation say the same counts."""

import json
from pathlib import Path
from typing import Any

import pytest

from meanflock.studies.paper import claims, search
from meanflock.studies.paper.outcome import Outcome
from meanflock.studies.paper.report import claims as report_claims
from meanflock.studies.paper.report import write
from meanflock.studies.paper.verdict import NOT_REPRODUCED, NOT_TESTABLE, REPRODUCED, UNDECIDED
from meanflock.swarm.scenario import load
from tests.pages import script_of

ROOT = Path(__file__).parents[2]


reproduction = script_of("reproduction")
RECORDS: list[dict[str, Any]] = json.loads((ROOT / "docs/results/claims.json").read_text(encoding="utf-8"))
MAP: dict[str, Any] = json.loads((ROOT / "docs/results/map.json").read_text(encoding="utf-8"))
REPRODUCTION = (ROOT / "docs/reproduction.md").read_text(encoding="utf-8")
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


def test_every_comparison_has_the_outcome_its_interval_says() -> None:
    for record in RECORDS:
        for test in record["tests"]:
            assert test["outcome"] == judged(*test["ci95"], test["needs"]), (record["id"], test)


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: record["id"])
def test_a_claim_fails_where_a_comparison_fails_and_is_undecided_where_none_does(record: dict[str, Any]) -> None:
    seen = {test["outcome"] for test in record["tests"]}
    if record["verdict"] == NOT_TESTABLE:
        return
    if record["id"] in OF_MOST:  # of its points some may fail
        assert record["verdict"] != REPRODUCED or Outcome.HOLDS in seen
    elif Outcome.FAILS in seen:
        assert record["verdict"] == NOT_REPRODUCED
    else:
        assert record["verdict"] == (UNDECIDED if Outcome.UNDECIDED in seen else REPRODUCED)


def test_readme_and_documentation_say_the_counts_that_were_found() -> None:
    counts = write.counts(RECORDS)
    assert sum(counts.values()) == 53
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    first_screen = " ".join(readme.partition("\n![")[0].split())
    reproduced, refuted, undecided, untestable = counts.values()
    sentence = (
        f"Of 53 claims of the paper {reproduced} are reproduced, {refuted} are not, "
        f"{undecided} are undecided and {untestable} cannot be tested"
    )
    assert sentence in first_screen
    held = [reproduction.counted(RECORDS, name)[REPRODUCED] for name in ("paper", "paper-slow", "paper-printed")]
    compared = "of its 53 claims {} hold at our default, {} where steering is slow, {} with its polynomial as printed"
    assert compared.format(*held) in " ".join(readme.split())


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
        assert (record["id"], record["statement"], record["kind"]) == (claim.id, claim.statement, claim.kind)
        assert (record["single_flights"] is None) or record["single_flights"][0] <= record["single_flights"][1]
        assert set(record["scenarios"]) == {"paper-slow", "paper-printed"}
