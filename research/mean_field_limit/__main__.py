"""Flies swarms of 10 to 100,000 UAVs and deviations of one UAV, and writes docs/mean-field-limit.md.

python -m research.mean_field_limit --jobs 1   # half an hour on one core, 2 GB; a repeated command flies the rest
python -m research.mean_field_limit --page     # the page again, from docs/results/mean_field_limit.json
"""

from meanflock.net import process
from meanflock.studies import published
from meanflock.studies.study import Summaries
from research.mean_field_limit import cases, fit, flights, page, picture


def main() -> None:
    """Fly every case, unless `--page` is set, and write the page; the results are written after each case."""
    given = published.options(__doc__, page=True).parse_args()
    if not given.page:
        fitted = fit.rows_of(published.flown("mean-field-limit", fit.fits(), given.jobs, fit.measure))
        measured: dict[flights.SwarmCase, Summaries] = {}
        for case, seeds in cases.cases().items():
            points = {case: [flights.flight(case, seed) for seed in seeds]}
            measured |= published.flown("mean-field-limit", points, given.jobs, flights.measure)
            (reference,) = measured[cases.REFERENCE]
            rows = [
                cases.row_of(flown, cases.FIRST_SEED + number, each, reference)
                for flown, found in measured.items()
                for number, each in enumerate(found)
            ]
            published.write_rows(page.RESULTS, fitted + rows)
    published.write_page(page.PAGE, page.page, page.RESULTS)
    picture.draw(published.read_rows(page.RESULTS)[1])


if __name__ == "__main__":
    process.main(main)
