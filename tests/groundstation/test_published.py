"""The published study: every verdict follows from its intervals, and README and documentation say the same counts."""

import json
import re
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from meanflock.groundstation.paper import claims, report, report_claims
from meanflock.groundstation.paper.outcome import Outcome
from meanflock.groundstation.paper.verdict import NOT_REPRODUCED, NOT_TESTABLE, REPRODUCED, UNDECIDED

ROOT = Path(__file__).parents[2]
RECORDS: list[dict[str, Any]] = json.loads((ROOT / "docs/results/claims.json").read_text(encoding="utf-8"))
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
    counts = report.counts(RECORDS)
    said = ", ".join(f"{count} {name}" for name, count in counts.items())
    assert f"{len(RECORDS)} claims: {said}." in REPRODUCTION
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    first_screen = " ".join(readme.partition("\n![")[0].split())
    reproduced, refuted, undecided, untestable = counts.values()
    sentence = (
        f"Of {len(RECORDS)} claims of the paper {reproduced} are reproduced in it, {refuted} are not, "
        f"{undecided} are left undecided by the data and {untestable} cannot be tested"
    )
    assert sentence in first_screen


def test_the_table_and_the_rule_are_those_of_the_code() -> None:
    rows = dict(re.findall(r"^\| (C\d+) \|.*\| \*\*([a-z ]+)\*\* \|", REPRODUCTION, re.MULTILINE))
    assert rows == {record["id"]: record["verdict"] for record in RECORDS}
    assert Counter(rows.values()) == Counter({k: v for k, v in report.counts(RECORDS).items() if v})
    assert report_claims.RULE in REPRODUCTION
