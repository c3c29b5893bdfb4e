"""Flies ways of learning until the swarm knows 90 % of the digits, and writes docs/price-of-accuracy.md.

python -m research.price_of_accuracy          # a quarter of an hour on one core; needs the extra `flower`
python -m research.price_of_accuracy --page   # the page again, from docs/results/price_of_accuracy.json
"""

from meanflock.net import process
from meanflock.studies import published
from research.price_of_accuracy import flights, page


def main() -> None:
    """Tune and fly every case, unless `--page` is set, and write the page."""
    given = published.options(__doc__, page=True).parse_args()
    if not given.page:
        published.write_rows(page.RESULTS, flights.fly(given.jobs))
    published.write_page(page.PAGE, page.page, page.RESULTS)


if __name__ == "__main__":
    process.main(main)
