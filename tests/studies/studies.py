"""Short studies and their files."""

import csv
import json
from pathlib import Path
from typing import Any

QUICK = ("--duration", "3", "--jobs", "1", "--quiet", "--out", "out")


def flown(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / "runs.jsonl").read_text().splitlines()]


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))
