"""`latest.json`: the results, and comparison with its last commit."""

import json
from pathlib import Path
from typing import Any

from benchmarks.figure import Outcome
from benchmarks.machine import ROOT, committed

SCHEMA = 1
LATEST = ROOT / "benchmarks" / "latest.json"
WORSE = 1.15


def race_record(title: str, about: str, found: Outcome | str, effort: str, seconds: float) -> dict[str, Any]:
    """One race; `found` is text where it could not be run."""
    failed = isinstance(found, str)
    return {
        "title": title,
        "about": about,
        "effort": effort,
        "seconds": round(seconds, 1),
        "error": found if failed else None,
        "figures": [] if failed else [figure.record() for figure in found.figures],
        "notes": [] if failed else found.notes,
        "details": {} if failed else found.details,
    }


def read(path: Path) -> dict[str, Any] | None:
    """A record of this schema; None where there is none."""
    try:
        return _valid(path.read_text(encoding="utf-8"))
    except OSError:
        return None


def baseline() -> dict[str, Any] | None:
    """The record of the last commit."""
    text = committed(LATEST.relative_to(ROOT).as_posix())
    return _valid(text) if text else None


def _valid(text: str) -> dict[str, Any] | None:
    try:
        record = json.loads(text)
    except json.JSONDecodeError:
        return None
    return record if isinstance(record, dict) and record.get("schema") == SCHEMA else None


def write(path: Path, record: dict[str, Any]) -> None:
    """Write the record atomically, with a newline at the end."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(record, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def worse(now: dict[str, Any], before: dict[str, Any]) -> list[str]:
    """Sentences about regressions: ratios to the floor that rose by more than 15 %, and races that fail now.

    Ratios only: machines differ. A quick run measures less, which is no loss.
    """
    found = []
    for race, record in now["races"].items():
        was_race = before["races"].get(race, {})
        old = {figure["name"]: figure for figure in was_race.get("figures", [])}
        if record["error"]:
            found += [f"{race}: cannot be measured any more: {record['error']}"] if old else []
            continue
        if record["effort"] == was_race.get("effort"):
            measured = {figure["name"] for figure in record["figures"]}
            found += [f"{race}: {name}: not measured any more" for name in old if name not in measured]
        for figure in record["figures"]:
            was = old.get(figure["name"], {}).get("ratio")
            ratio, better = figure["ratio"], figure["better"]
            if not was or not ratio or better == "neither":
                continue
            change = ratio / was if better == "lower" else was / ratio
            if change > WORSE:
                found.append(
                    f"{race}: {figure['name']}: {ratio:.2f} times its floor, was {was:.2f} "
                    f"({(change - 1) * 100:.0f} % worse)"
                )
    return found
