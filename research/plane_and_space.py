"""Flies the paper's methods, ORCA and filters in the plane and in space, and writes docs/plane-and-space.md.

python -m research.plane_and_space          # half an hour on two cores
python -m research.plane_and_space --page   # the tables again, from docs/results/plane_and_space.json
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from meanflock.net import process
from meanflock.results import statistics
from meanflock.results.statistics import Estimate
from meanflock.studies import published
from meanflock.studies.frontier import policies
from meanflock.studies.leaderboard import missions
from meanflock.studies.leaderboard.rows import chosen
from meanflock.studies.markdown import table, with_parts
from meanflock.swarm.scenario import Scenario

PAGE = published.DOCS / "plane-and-space.md"
RESULTS = published.DOCS / "results" / "plane_and_space.json"
FIRST_SEED = 94101  # no other study uses these seeds
PLANE, SPACE = "plane", "space"
LEARNED = ("hjb", "mfg", "mfgfl-h", "mfgfl-f", "mfgfl-hf")
METHODS = ("offline", *LEARNED, "mfgfl-h-ecbf", "cruise", "cruise-ecbf", "cruise-braking", "orca")
SHARED = ("orca", "cruise-ecbf")  # methods that fly under several policies of sharing
POLICIES = ("event-4", "event", "event-1m")
CROWDED = ("swap", "streams")  # missions on which they do: on the paper's hardly any two come near each other
MISSIONS: dict[str, dict[str, tuple[str, dict[str, Any]]]] = {  # by name, in the plane and in space: mission and keys
    "paper": {PLANE: ("paper", {}), SPACE: ("paper", {"start.layers": 3})},
    "swap": {PLANE: ("swap", {}), SPACE: ("sphere", {})},
    "streams": {PLANE: ("streams", {}), SPACE: ("streams", {"start.layers": 3})},
}
UAVS = {"paper": 25, "swap": 32, "streams": 32}
Case = tuple[str, str, str, str]  # mission, method, policy of sharing or "", plane or space
Flight = dict[str, Any]


def main() -> None:
    """Fly the cases, unless `--page` is set, and write the page."""
    given = published.options(__doc__, seeds=30, page=True).parse_args()
    if not given.page:
        seeds = range(FIRST_SEED, FIRST_SEED + given.seeds)
        points = {case: [scenario(case, seed) for seed in seeds] for case in cases()}
        found = published.flown("plane-and-space", points, given.jobs)
        rows = [
            flight_of(case, seed, summary)
            for case, summaries in found.items()
            for seed, summary in zip(seeds, summaries, strict=True)
        ]
        published.write_rows(RESULTS, rows)
    published.write_page(PAGE, page, RESULTS)


def cases() -> list[Case]:
    """Every case, in the order of the tables."""
    flown = [(mission, method, "") for mission in MISSIONS for method in METHODS]
    flown += [(mission, method, policy) for mission in CROWDED for method in SHARED for policy in POLICIES[1:]]
    return [(*case, where) for case in flown for where in (PLANE, SPACE)]


def scenario(case: Case, seed: int) -> Scenario:
    """One flight of a case; both arms have the same method, settings, seeds and number of UAVs."""
    mission, method, policy, where = case
    name, keys = MISSIONS[mission][where]
    (found,) = missions.chosen([name])
    (row,) = chosen([method])
    sharing = {each.name: each.settings for each in policies.shipped()["states"]}
    settings = keys | (sharing[policy] if policy else {}) | ({"space.dimensions": 3} if where == SPACE else {})
    return row.scenario(found.table() | {"uavs": UAVS[mission]}, seed, name).replace(**settings)


def flight_of(case: Case, seed: int, summary: Mapping[str, Any]) -> Flight:
    """Row of one flight in the results."""
    return {
        **dict(zip(("mission", "method", "policy", "where"), case, strict=True)),
        "seed": seed,
        "time_s": summary["t_avg_censored_s"],
        "energy_J": summary["energy_mean_J"],
        "collisions": summary["collisions_all"],
        "closest_m": summary["closest_approach_m"],
        "kbit": summary["bits_to_arrival"]["total"] / 1e3,
        "arrived": summary["arrived"],
        "uavs": summary["uavs"],
        "trajectory_sha256": summary["trajectory_sha256"],
    }


def page(text: str, code: str, flights: Sequence[Flight]) -> str:
    """The page `text` with the tables of these flights."""
    seeds = len({flight["seed"] for flight in flights})
    flown = (
        f"{len(flights):,} flights, {seeds} of each case, with seeds from {FIRST_SEED} on. {published.flown_by(code)}"
    )
    parts = {"flights": [flown], "findings": _findings(flights), "bits": _bits(flights)}
    parts |= {mission: _methods(flights, mission) for mission in MISSIONS}
    return with_parts(text, parts)


def of(flights: Sequence[Flight], mission: str, method: str, policy: str, where: str) -> list[Flight]:
    """The flights of a case, by ascending seed."""
    case = (mission, method, policy, where)
    return [one for one in flights if (one["mission"], one["method"], one["policy"], one["where"]) == case]


def verdict(change: Estimate) -> str:
    """The change in a word: less, more, or undecided if its 95 % interval contains 0."""
    if change.low <= 0.0 <= change.high:
        return "undecided"
    return "more" if change.value > 0.0 else "less"


def _methods(flights: Sequence[Flight], mission: str) -> list[str]:
    """A row for each method: each measure in the plane and in space."""
    rows = []
    for method in METHODS:
        arms = [of(flights, mission, method, "", where) for where in (PLANE, SPACE)]
        rows.append(
            (
                f"`{method}`",
                _beside(arms, lambda arm: f"{_mean(arm, 'time_s').value:.1f}"),
                _beside(arms, lambda arm: f"{_mean(arm, 'energy_J').value:.2f}"),
                _beside(arms, lambda arm: f"{_mean(arm, 'collisions').value:.2f}"),
                _beside(arms, _free),
                _beside(arms, lambda arm: f"{_mean(arm, 'kbit').value:.1f}"),
                _beside(arms, _arrived),
            )
        )
    return table(("method", "T, s", "E, J", "collisions", "free flights", "kbit", "arrived"), rows)


def _findings(flights: Sequence[Flight]) -> list[str]:
    """A row for each mission and learned method: time, energy and collisions less those of `hjb`, paired by seed."""
    rows = []
    for mission in MISSIONS:
        for method in LEARNED[1:]:
            cells = []
            for name in ("time_s", "energy_J", "collisions"):
                for where in (PLANE, SPACE):
                    ours, theirs = (of(flights, mission, each, "", where) for each in (method, "hjb"))
                    change = statistics.difference([one[name] for one in ours], [one[name] for one in theirs])
                    shown = f"{change.value:+.3g} [{change.low:+.3g}, {change.high:+.3g}]"
                    cells.append(f"{shown}, {verdict(change)}")
            rows.append((mission, f"`{method}`", *cells))
    head = ("T, s: plane", "space", "E, J: plane", "space", "collisions: plane", "space")
    return table(("mission", "method", *head), rows)


def _bits(flights: Sequence[Flight]) -> list[str]:
    """A row for each mission, method and policy: bits and collisions, in the plane and in space."""
    rows = []
    for mission in CROWDED:
        for method in SHARED:
            for policy in POLICIES:
                name = "" if policy == POLICIES[0] else policy
                arms = [of(flights, mission, method, name, where) for where in (PLANE, SPACE)]
                rows.append(
                    (
                        mission,
                        f"`{method}`",
                        f"`{policy}`",
                        *(f"{_mean(arm, 'kbit').value:.1f}" for arm in arms),
                        *(_mean(arm, "collisions").shown(".2f") for arm in arms),
                        *(_free(arm) for arm in arms),
                    )
                )
    head = ("kbit: plane", "space", "collisions: plane", "space", "free flights: plane", "space")
    return table(("mission", "method", "policy", *head), rows)


def _beside(arms: Sequence[Sequence[Flight]], shown: Callable[[Sequence[Flight]], str]) -> str:
    return " / ".join(shown(arm) for arm in arms)


def _mean(flights: Sequence[Flight], name: str) -> Estimate:
    return statistics.mean([one[name] for one in flights])


def _free(flights: Sequence[Flight]) -> str:
    return f"{sum(one['collisions'] == 0 for one in flights)} of {len(flights)}"


def _arrived(flights: Sequence[Flight]) -> str:
    return f"{sum(one['arrived'] for one in flights)} of {sum(one['uavs'] for one in flights)}"


if __name__ == "__main__":
    process.main(main)
