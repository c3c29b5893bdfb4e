"""Flies the central comparisons of federation.md and price-of-safety.md with bands of their own and in one band.

python -m research.one_band          # 200 flights; five minutes on one core
python -m research.one_band --page   # the tables again, from docs/results/one_band.json
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from meanflock.net import process
from meanflock.results import statistics
from meanflock.studies import published
from meanflock.studies.frontier import policies
from meanflock.studies.leaderboard import missions
from meanflock.studies.leaderboard.rows import BoardRow
from meanflock.studies.markdown import replaced, table
from meanflock.swarm.scenario import Scenario
from research.federation import ECBF, MODELS, NEIGHBOURS

PAGES = {"models": published.DOCS / "federation.md", "states": published.DOCS / "round-cost.md"}  # by table
RESULTS = published.DOCS / "results" / "one_band.json"
FIRST_SEED = 93101  # no other study uses these seeds
ACCESS = {"own bands": "fdma", "one band": "tdma"}
WAYS: dict[str, dict[str, Any]] = {"leader": {}, "clusters": {"federation.clusters": 5}, "neighbours": NEIGHBOURS}
POLICIES = {"orca": "event-0.6m", "bvc": "event-0.6m", "vasarhelyi": "event-v", "cruise-ecbf": "event"}
MISSIONS = {"models": ("paper", "lossy"), "states": ("streams",)}
NAMES = {"models": tuple(WAYS), "states": tuple(POLICIES)}
Case = tuple[str, str, str, str]  # table, mission, way or controller, and bands
Flight = dict[str, Any]


def main() -> None:
    """Fly the cases, unless `--page` is set, and write the tables."""
    given = published.options(__doc__, seeds=10, page=True).parse_args()
    if not given.page:
        seeds = range(FIRST_SEED, FIRST_SEED + given.seeds)
        points = {case: [scenario(case, seed) for seed in seeds] for case in cases()}
        found = published.flown("one-band", points, given.jobs)
        rows = [
            flight_of(case, seed, summary)
            for case, summaries in found.items()
            for seed, summary in zip(seeds, summaries, strict=True)
        ]
        published.write_rows(RESULTS, rows)
    for path in PAGES.values():
        published.write_page(path, page, RESULTS)


def cases() -> list[Case]:
    """Every case, in the order of the tables."""
    return [
        (kind, mission, name, bands)
        for kind, names in NAMES.items()
        for mission in MISSIONS[kind]
        for name in names
        for bands in ACCESS
    ]


def scenario(case: Case, seed: int) -> Scenario:
    """One flight of a case, as the pages fly it, with the acceleration limit of the leaderboard."""
    kind, mission, name, bands = case
    access = {"radio.access": ACCESS[bands]}
    if kind == "models":
        row = BoardRow(name, "fed-lspi", settings=ECBF | WAYS[name] | access)
    else:
        method, _, kept_apart = name.partition("-")
        apart = {"filter.kind": kept_apart} if kept_apart else {}
        sharing = {policy.name: policy.settings for policy in policies.shipped()["states"]}
        row = BoardRow(name, method, settings=apart | sharing[POLICIES[name]] | access)
    (found,) = missions.chosen([mission])
    return row.scenario(found.table() | {"uavs": 25}, seed, mission)


def flight_of(case: Case, seed: int, summary: Mapping[str, Any]) -> Flight:
    """Row of one flight in the results."""
    radio, cost = summary["radio"], summary["diagnostics"].get("tracking_cost")
    return {
        **dict(zip(("table", "mission", "name", "bands"), case, strict=True)),
        "seed": seed,
        "kbit": summary["payload_bits"]["total"] / 1e3,
        "models_airtime_s": sum(radio["traffic"][kind]["airtime_s"] for kind in MODELS),
        "band_time_MHz_s": radio["band_time_Hz_s"] / 1e6,
        "tracking": None if cost is None else cost / summary["uavs"],
        "collisions": summary["collisions_all"] + summary["obstacle_hits"],
        "arrived": summary["arrived"],
        "uavs": summary["uavs"],
        "trajectory_sha256": summary["trajectory_sha256"],
    }


def page(text: str, code: str, flights: Sequence[Flight]) -> str:
    """The page `text` with those of the tables that it has."""
    for kind in PAGES:
        if (begin := f"<!-- one band: {kind} -->") in text:
            here = [flight for flight in flights if flight["table"] == kind]
            seeds = len({flight["seed"] for flight in here})
            flown = f"{seeds} flights of each case, with seeds from {FIRST_SEED} on. {published.flown_by(code)}"
            lines = ["", *(_models(here) if kind == "models" else _states(here)), "", flown, ""]
            text = replaced(text, begin, "<!-- end -->", lines)
    return text


def _models(flights: Sequence[Flight]) -> list[str]:
    """A row for each mission and bands, with the ratio of each way's tracking to the leader's, paired by seed."""
    rows = []
    for mission in MISSIONS["models"]:
        for bands in ACCESS:
            by_way = {name: _of(flights, mission, name, bands) for name in WAYS}
            first = _logarithms(by_way["leader"])
            cells = [f"{math.exp(statistics.mean(first).value):.3g}"]
            for name in ("clusters", "neighbours"):
                ratio = statistics.difference(_logarithms(by_way[name]), first)
                ends = [f"{math.exp(end):.2f}" for end in (ratio.value, ratio.low, ratio.high)]
                cells.append(
                    f"× {ends[0]} [{ends[1]}, {ends[2]}]" + ("" if ratio.low * ratio.high > 0 else ", undecided")
                )
            cells += [" / ".join(f"{_mean(here, 'band_time_MHz_s'):.2f}" for here in by_way.values())]
            arrived = sum(one["arrived"] for here in by_way.values() for one in here)
            cells.append(f"{arrived} of {sum(one['uavs'] for here in by_way.values() for one in here)}")
            rows.append((mission, bands, *cells))
    head = ("mission", "", "leader", "clusters", "neighbours", "MHz·s, in this order", "arrived")
    return table(head, rows)


def _states(flights: Sequence[Flight]) -> list[str]:
    """A row for each controller and bands."""
    rows = []
    for name in POLICIES:
        for bands in ACCESS:
            here = _of(flights, "streams", name, bands)
            free = statistics.share([one["collisions"] == 0 for one in here])
            rows.append(
                (
                    f"`{name}`, `{POLICIES[name]}`",
                    bands,
                    f"{round(free.value * len(here))} of {len(here)} ({100 * free.low:.0f}…{100 * free.high:.0f} %)",
                    f"{_mean(here, 'kbit'):.1f}",
                    f"{_mean(here, 'band_time_MHz_s'):.3f}",
                    f"{sum(one['arrived'] for one in here)} of {sum(one['uavs'] for one in here)}",
                )
            )
    return table(("controller, policy", "", "free flights", "kbit", "MHz·s", "arrived"), rows)


def _of(flights: Sequence[Flight], mission: str, name: str, bands: str) -> list[Flight]:
    """The flights of a case."""
    return [one for one in flights if (one["mission"], one["name"], one["bands"]) == (mission, name, bands)]


def _logarithms(flights: Sequence[Flight]) -> list[float]:
    return [math.log(flight["tracking"]) for flight in flights]


def _mean(flights: Sequence[Flight], name: str) -> float:
    return statistics.mean([flight[name] for flight in flights]).value


if __name__ == "__main__":
    process.main(main)
