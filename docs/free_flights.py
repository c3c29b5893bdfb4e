"""Flies those who promise not to collide, on seeds that nothing was tuned on, and writes their table in controllers.md.

python docs/free_flights.py          # 400 flights; five minutes on two cores
python docs/free_flights.py --page   # the table again, from docs/results/free_flights.json
"""

import argparse
import json
from collections.abc import Iterable, Sequence
from itertools import count, product
from pathlib import Path
from typing import Any

from joblib import Parallel, delayed
from rich.console import Console
from rich.progress import track

from meanflock.groundstation import statistics
from meanflock.groundstation.launch.engine import Engine
from meanflock.studies.markdown import replaced
from meanflock.swarm import scenario

HERE = Path(__file__).parent
PAGE, RESULTS = HERE / "controllers.md", HERE / "results" / "free_flights.json"
BEGIN, END = "<!-- table: docs/free_flights.py -->", "<!-- end of table -->"
FIRST_SEED = 9001
OUTAGE_SNR_DB = {0.03: None, 12.0: 75.8876, 50.0: 76.3523}  # of a message of one slot, %; None: the paper's
SWARMS, SHAKES = (25, 64), (0.1, 0.5)  # UAVs; σ of the wind
KEPT = ("collisions_all", "closest_approach_m", "arrived", "t_avg_s", "energy_mean_J")
Row = dict[str, Any]


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--jobs", type=int, default=-1, help="processes; -1 for one a core")
    options.add_argument("--page", action="store_true", help="write the table from the results that are there")
    given = options.parse_args()
    if not given.page:
        work = list(cases())
        flights = Parallel(n_jobs=given.jobs, return_as="generator")(delayed(fly)(*case) for case in work)
        rows = list(track(flights, "free flights", len(work), console=Console(stderr=True)))
        RESULTS.write_text("[\n" + ",\n".join(map(json.dumps, rows)) + "\n]\n", encoding="utf-8")
    lines = table(json.loads(RESULTS.read_text(encoding="utf-8")))
    page = replaced(PAGE.read_text(encoding="utf-8"), BEGIN, END, ["", *lines, ""])
    PAGE.write_text(page, encoding="utf-8")
    print(PAGE)


def cases() -> Iterable[tuple[str, int, float, float, int]]:
    """Method, UAVs, σ, outage in % and seed of each flight."""
    seeds = count(FIRST_SEED)  # every flight has its own: what hardly speaks flies alike whatever the radio loses
    for uavs, sigma, outage in product(SWARMS, SHAKES, OUTAGE_SNR_DB):
        yield from (("plan", uavs, sigma, outage, next(seeds)) for _ in range(25))
    yield from (("fed-lspi", SWARMS[0], SHAKES[0], min(OUTAGE_SNR_DB), next(seeds)) for _ in range(100))


def fly(method: str, uavs: int, sigma: float, outage: float, seed: int) -> Row:
    """One flight behind the filter, with its defaults."""
    settings = ["filter.kind=ecbf", f"wind.sigma={sigma}"]
    if (snr := OUTAGE_SNR_DB[outage]) is not None:
        settings.append(f"radio.target_snr_db={snr}")
    summary = Engine(scenario.load(None, settings, method=method, uavs=uavs, seed=seed), "free-flights").complete()
    case = {"method": method, "uavs": uavs, "sigma": sigma, "outage_percent": outage, "seed": seed}
    return case | {name: summary[name] for name in KEPT} | {"kbit": summary["payload_bits"]["total"] / 1e3}


def table(rows: Sequence[Row]) -> list[str]:
    """A row a case, and one of all flights of `plan`."""
    lines = [
        "| behind `ecbf` | UAVs | σ | outages, % | free flights | closest two, m | mean trip, s | energy, J | kbit |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for case in dict.fromkeys((row["method"], row["uavs"], row["sigma"], row["outage_percent"]) for row in rows):
        of = [row for row in rows if (row["method"], row["uavs"], row["sigma"], row["outage_percent"]) == case]
        lines.append(_line(f"`{case[0]}` | {case[1]} | {case[2]} | {case[3]:g}", of))
    plans = [row for row in rows if row["method"] == "plan"]
    return [*lines, _line("`plan`, all of them | | | ", plans)]


def _line(case: str, rows: Sequence[Row]) -> str:
    free = statistics.share([row["collisions_all"] == 0 for row in rows])
    closest = min(row["closest_approach_m"] for row in rows)
    trip, energy, kbit = (sum(row[name] for row in rows) / len(rows) for name in ("t_avg_s", "energy_mean_J", "kbit"))
    said = f"{round(free.value * free.n)} of {free.n} ({100 * free.low:.1f}…{100 * free.high:.1f} %)"
    return f"| {case} | {said} | {closest:.2f} | {trip:.1f} | {energy:.2f} | {kbit:,.0f} |"


if __name__ == "__main__":
    main()
