"""Short studies and their files; tests of studies may use what those of the ground station do."""

import csv
import json
from pathlib import Path
from typing import Any

from tests.groundstation.conftest import environment, run, strict, undrawn

__all__ = ["environment", "run", "strict", "undrawn"]


QUICK = ("--duration", "3", "--jobs", "1", "--quiet", "--out", "out")


def flown(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / "runs.jsonl").read_text().splitlines()]


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))
