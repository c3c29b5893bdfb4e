"""Numbers in the prose of the pages that no result has: `python -m tests.golden.numbers` writes them to numbers.csv.

They are definitions, defaults, sizes of examples and years. A number that was measured or computed has a row in
`tests/sentences.py` instead, which compares it with the results.
"""

import csv
import re
from pathlib import Path

from tests.sentences import written

ROOT = Path(__file__).parents[2]
FILE = Path(__file__).with_name("numbers.csv")
GENERATED = {f"docs/{page}.md" for page in ("api", "cli", "data", "keys", "leaderboard", "price-of-safety")}
CODE = r"`[^`]*`|\]\([^)]*\)"
WRITTEN_BY_A_PROGRAM = r"<!-- (?!end)[^>]*-->.*?<!-- end.*?-->|```.*?```"  # and boxes
TABLE = r"^\|.*$"
NUMBER = r"(?<![\w.,/-])(?!(?:19|20)\d\d\b|\d\. )\d[\d.,]*(?:\s?[%×]|\s[^\s\d]+)?"  # neither years nor items of lists


def pages() -> list[str]:
    """The pages that people write."""
    listed = sorted(path.relative_to(ROOT).as_posix() for path in (*ROOT.glob("*.md"), *ROOT.glob("docs/*.md")))
    return [page for page in listed if page not in {*GENERATED, "CHANGELOG.md"}]


def found(page: str) -> list[str]:
    """The numbers of a page, each with the word behind it, but for those in sentences that the results check."""
    text = re.sub(WRITTEN_BY_A_PROGRAM, "", (ROOT / page).read_text(encoding="utf-8"), flags=re.S)
    text = " ".join(re.sub(TABLE, "", text, flags=re.M).split())
    for sentence in written(page):
        text = text.replace(sentence, "")
    return sorted({each.rstrip(".,;:)*") for each in re.findall(NUMBER, re.sub(CODE, "", text))})


def read() -> dict[str, list[str]]:
    """The numbers of the file by page."""
    with FILE.open(newline="", encoding="utf-8") as file:
        return {page: numbers for page, *numbers in csv.reader(file)}


if __name__ == "__main__":
    with FILE.open("w", newline="", encoding="utf-8") as file:
        rows = [[page, *found(page)] for page in pages()]
        csv.writer(file, lineterminator="\n").writerows(rows)
