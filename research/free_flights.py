"""Flies collision-free controllers on seeds that were not used for tuning, and writes their table in controllers.md.

python -m research.free_flights          # 400 flights; five minutes on two cores
python -m research.free_flights --page   # the table again, from docs/results/free_flights.json
"""

from collections.abc import Iterable, Mapping, Sequence
from itertools import count, product
from typing import Any

from meanflock.net import process
from meanflock.results import statistics
from meanflock.studies import published
from meanflock.studies.markdown import replaced
from meanflock.swarm import scenario
from meanflock.swarm.scenario import Scenario

PAGE = published.DOCS / "controllers.md"
RESULTS = published.DOCS / "results" / "free_flights.json"
BEGIN, END = "<!-- table: research.free_flights -->", "<!-- end of table -->"
FIRST_SEED = 109001
OUTAGE_SNR_DB = {0.03: None, 12.0: 75.8876, 50.0: 76.3523}  # outage of a message of one slot, %; None: as in the paper
SWARMS, SHAKES = (25, 64), (0.1, 0.5)  # UAVs; σ of the wind
KEPT = ("collisions_all", "closest_approach_m", "arrived", "t_avg_s", "energy_mean_J")
Case = tuple[str, int, float, float, int]  # method, UAVs, σ, outage in % and seed
Row = dict[str, Any]


def main() -> None:
    """Fly the cases of the table, unless `--page` is set, and write the table."""
    given = published.options(__doc__, page=True).parse_args()
    if not given.page:
        points = {case: [case_scenario(*case)] for case in cases()}
        found = published.flown("free-flights", points, given.jobs)
        published.write_rows(RESULTS, [row_of(case, summary) for case, (summary,) in found.items()])
    published.write_page(PAGE, page, RESULTS)


def cases() -> Iterable[Case]:
    """All cases."""
    seeds = count(FIRST_SEED)  # a seed for each flight, because UAVs that send little fly alike at every outage
    for uavs, sigma, outage in product(SWARMS, SHAKES, OUTAGE_SNR_DB):
        yield from (("plan", uavs, sigma, outage, next(seeds)) for _ in range(25))
    yield from (("fed-lspi", SWARMS[0], SHAKES[0], min(OUTAGE_SNR_DB), next(seeds)) for _ in range(100))


def case_scenario(method: str, uavs: int, sigma: float, outage: float, seed: int) -> Scenario:
    """A flight behind the filter, with its defaults."""
    settings = ["filter.kind=ecbf", f"wind.sigma={sigma}"]
    if (snr := OUTAGE_SNR_DB[outage]) is not None:
        settings.append(f"radio.target_snr_db={snr}")
    return scenario.load(None, settings, method=method, uavs=uavs, seed=seed)


def row_of(case: Case, summary: Mapping[str, Any]) -> Row:
    """Row of one flight in the results."""
    named = dict(zip(("method", "uavs", "sigma", "outage_percent", "seed"), case, strict=True))
    return named | {name: summary[name] for name in KEPT} | {"kbit": summary["payload_bits"]["total"] / 1e3}


def page(text: str, code: str, rows: Sequence[Row]) -> str:
    """The page `text` with the table of these flights."""
    return replaced(text, BEGIN, END, ["", *table(rows), "", published.flown_by(code), ""])


def table(rows: Sequence[Row]) -> list[str]:
    """A row a case, and one of all flights of `plan`."""
    lines = [
        "| behind `ecbf` | UAVs | σ | outages, % | free flights | closest two, m | mean trip, s | energy, J | kbit |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for case in dict.fromkeys((row["method"], row["uavs"], row["sigma"], row["outage_percent"]) for row in rows):
        flights = [row for row in rows if (row["method"], row["uavs"], row["sigma"], row["outage_percent"]) == case]
        lines.append(_line(f"`{case[0]}` | {case[1]} | {case[2]} | {case[3]:g}", flights))
    plans = [row for row in rows if row["method"] == "plan"]
    return [*lines, _line("`plan`, all of them | | | ", plans)]


def _line(case: str, rows: Sequence[Row]) -> str:
    free = statistics.share([row["collisions_all"] == 0 for row in rows])
    closest = min(row["closest_approach_m"] for row in rows)
    trip, energy, kbit = (sum(row[name] for row in rows) / len(rows) for name in ("t_avg_s", "energy_mean_J", "kbit"))
    share = f"{round(free.value * free.n)} of {free.n} ({100 * free.low:.1f}…{100 * free.high:.1f} %)"
    return f"| {case} | {share} | {closest:.2f} | {trip:.1f} | {energy:.2f} | {kbit:,.0f} |"


if __name__ == "__main__":
    process.main(main)
