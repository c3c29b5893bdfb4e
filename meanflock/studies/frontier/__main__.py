"""Writes docs/price-of-safety.md and its pictures.

meanflock frontier --out out/frontier                    # flies; repeat it to go on
python -m meanflock.studies.frontier out/frontier        # takes its frontier.json and writes the page
python -m meanflock.studies.frontier --page              # the page again, from docs/results/frontier.json
"""

import argparse
import shutil
from pathlib import Path

from meanflock.net import process
from meanflock.studies import equal_bits, published
from meanflock.studies.frontier import page, picture, record
from meanflock.swarm.errors import BadInput


def main(arguments: list[str] | None = None, docs: Path = published.DOCS) -> None:
    """Write the page into `docs`, from the folder of a frontier or from the results that are there."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", nargs="?", type=Path, help="folder of a frontier")
    parser.add_argument("--page", action="store_true", help="write the page from the results that are there")
    given = parser.parse_args(arguments)
    if (given.out is None) != given.page:
        raise BadInput("give the folder of a frontier, or --page for the results that are there")
    results = docs / "results" / record.FILE
    found = record.read(results if given.page else given.out / record.FILE)
    if not given.page:
        shutil.copyfile(given.out / record.FILE, results)
    text = page.page(found)
    if (ranking := docs / "results" / equal_bits.RESULTS.name).exists():
        text = equal_bits.page(text, *published.read_rows(ranking))
    (docs / "price-of-safety.md").write_text(text, encoding="utf-8")
    for path in picture.write(found, docs / page.PICTURES):
        if path.suffix == ".svg":
            path.unlink()
    print(docs / "price-of-safety.md")


if __name__ == "__main__":
    process.main(main)
