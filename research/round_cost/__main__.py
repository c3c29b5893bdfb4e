"""Flies ways of averaging on several radios, and writes docs/round-cost.md.

python -m research.round_cost          # half an hour on one core
python -m research.round_cost --page   # the page again, from docs/results/round_cost.json
"""

from meanflock.net import process
from meanflock.studies import published
from research.round_cost import flights, page


def main() -> None:
    """Fly every cell, unless `--page` is set, and write the page."""
    given = published.options(__doc__, page=True).parse_args()
    if not given.page:
        flights.load_classifier()
        points = {cell: flights.flights(cell, flights.seeds(cell)) for cell in flights.cells()}
        found = published.flown("round_cost", points, given.jobs, flights.measure)
        rows = [
            {**cell._asdict(), "seed": seed, **row}
            for cell, measured in found.items()
            for seed, row in zip(flights.seeds(cell), measured, strict=True)
        ]
        published.write_rows(page.RESULTS, rows)
    published.write_page(page.PAGE, page.page, page.RESULTS)


if __name__ == "__main__":
    process.main(main)
