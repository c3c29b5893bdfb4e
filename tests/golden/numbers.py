"""Numbers in the prose of the pages that no result has: `python -m tests.golden.numbers` writes them to numbers.csv.

They are definitions, defaults, sizes of examples and years. A number that was measured or computed has a row in
`tests/test_prose.py` instead, which compares it with the results.
"""

import csv
import re
import subprocess
from pathlib import Path

ROOT = Path(__file__).parents[2]
FILE = Path(__file__).with_name("numbers.csv")
GENERATED = {"CHANGELOG.md", *(f"docs/{page}.md" for page in ("api", "cli", "data", "keys", "leaderboard", "price-of-safety"))}
CODE = r"```.*?```|`[^`]*`|\]\([^)]*\)|\$[^$]*\$"
WRITTEN_BY_A_PROGRAM = r"<!-- (?!end)[^>]*-->.*?<!-- end.*?-->"
TABLE = r"^\|.*$"
NUMBER = r"(?<![\w.,])[\d][\d.,]*(?:\s?[%×]|\s[^\s\d]+)?"


def pages() -> list[str]:
    """The pages that people write."""
    listed = subprocess.run(["git", "ls-files", "*.md"], cwd=ROOT, check=True, capture_output=True, text=True)
    return [page for page in listed.stdout.split() if page not in GENERATED]


def numbers(page: str, compared: list[str]) -> list[str]:
    """Numbers of a page, each with the word behind it, without the sentences `compared` with results."""
    text = (ROOT / page).read_text(encoding="utf-8")
    for pattern in (WRITTEN_BY_A_PROGRAM, "```.*?```"):
        text = re.sub(pattern, "", text, flags=re.S)
    text = " ".join(re.sub(TABLE, "", text, flags=re.M).split())
    for sentence in compared:
        text = text.replace(sentence, "")
    return sorted({found.rstrip(".,;:)*") for found in re.findall(NUMBER, re.sub(CODE, "", text))})
