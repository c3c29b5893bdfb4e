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
GENERATED = {
    "CHANGELOG.md",
    *(f"docs/{page}.md" for page in ("api", "cli", "data", "keys", "leaderboard", "price-of-safety")),
}
BOX = r"```.*?```"
CODE = r"`[^`]*`|\]\([^)]*\)"
WRITTEN_BY_A_PROGRAM = r"<!-- (?!end)[^>]*-->.*?<!-- end.*?-->"
TABLE = r"^\|.*$"
NUMBER = r"(?<![\w.,/-])(?!(?:19|20)\d\d\b|\d\. )\d[\d.,]*(?:\s?[%×]|\s[^\s\d]+)?"  # neither years nor items of lists


def pages() -> list[str]:
    """The pages that people write."""
    listed = sorted(path.relative_to(ROOT).as_posix() for path in (*ROOT.glob("*.md"), *ROOT.glob("docs/*.md")))
    return [page for page in listed if page not in GENERATED]


def found(page: str, compared: list[str]) -> list[str]:
    """The numbers of a page, each with the word behind it, but for those in sentences that are `compared`."""
    text = (ROOT / page).read_text(encoding="utf-8")
    for pattern in (WRITTEN_BY_A_PROGRAM, BOX):
        text = re.sub(pattern, "", text, flags=re.S)
    text = " ".join(re.sub(TABLE, "", text, flags=re.M).split())
    for sentence in compared:
        text = text.replace(sentence, "")
    return sorted({each.rstrip(".,;:)*") for each in re.findall(NUMBER, re.sub(CODE, "", text))})


def read() -> dict[str, list[str]]:
    """The numbers of the file by page."""
    with FILE.open(newline="", encoding="utf-8") as file:
        return {page: numbers for page, *numbers in csv.reader(file)}


def main() -> None:
    """Writes the file."""
    with FILE.open("w", newline="", encoding="utf-8") as file:
        for page in pages():
            csv.writer(file, lineterminator="\n").writerow([page, *found(page, written(page))])


if __name__ == "__main__":
    main()
