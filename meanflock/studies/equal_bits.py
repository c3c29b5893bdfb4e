"""Ranks controllers by free flights at equal bits, and writes the ranking of price-of-safety.md.

python -m meanflock.studies.equal_bits          # 2,800 flights; a quarter of an hour on two cores
python -m meanflock.studies.equal_bits --page   # the ranking again, from docs/results/equal_bits.json

For each mission and budget a controller chooses its policy of communication: the one with the most free flights on
the seeds of the choice, among those whose mean payload is within the budget; among equals the cheapest. The ranking is
of `FIRST` seeds, and the `SECOND` seeds test it.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations, product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meanflock.net import process
from meanflock.results import statistics
from meanflock.studies import published
from meanflock.studies.frontier import policies
from meanflock.studies.frontier.grid import outcome
from meanflock.studies.frontier.search import ARRIVES, FlightOutcome
from meanflock.studies.leaderboard import flights, marks, missions, rows
from meanflock.studies.markdown import replaced, table
from meanflock.swarm.scenario import Scenario

PAGE = published.DOCS / "price-of-safety.md"
RESULTS = published.DOCS / "results" / "equal_bits.json"
BEGIN, END = "<!-- ranking: meanflock.studies.equal_bits -->", "<!-- end of ranking -->"
CONTROLLERS = ("orca", "bvc", "vasarhelyi", "olfati-saber", "potential-field", "cruise-ecbf", "cruise-braking")
MISSIONS = {"lossy": 25, "streams": 64}  # name → UAVs
BUDGETS = (2.0, 4.0, 8.0)  # kbit a UAV
CHOICE, FIRST, SECOND = range(199001, 199011), range(199101, 199131), range(199201, 199231)  # seeds
NONE = "none within the budget"
Row = dict[str, Any]


class Choice(NamedTuple):
    """A controller under a policy in a mission."""

    mission: str
    controller: str
    policy: str


def main() -> None:
    """Fly the choice and the ranking, unless `--page` is set, and write the ranking."""
    given = published.options(__doc__, page=True).parse_args()
    if not given.page:
        every = candidates()
        found = flown("equal-bits-choice", every, CHOICE, given.jobs)
        wanted = {place: chosen(found, *place) for place in places()}
        needed = {each: every[each] for each in wanted.values() if each is not None}
        ranked = flown("equal-bits", needed, (*FIRST, *SECOND), given.jobs)
        published.write_rows(RESULTS, [row_of(place, each, ranked) for place, each in wanted.items()])
    published.write_page(PAGE, page, RESULTS)


def places() -> Iterator[tuple[str, float, str]]:
    """Every mission, budget and controller."""
    return product(MISSIONS, BUDGETS, CONTROLLERS)


def candidates() -> dict[Choice, Scenario]:
    """Every controller under every policy, with the first seed of the choice."""
    found = {}
    for mission in missions.chosen(list(MISSIONS)):
        for row in rows.chosen(list(CONTROLLERS)):
            for policy in policies.of_row(row, mission.table(), mission.name):
                flight = policy.applied_to(row).scenario(mission.table(), CHOICE[0], mission.name)
                found[Choice(mission.name, row.name, policy.name)] = flight
    return found


def flown(
    study: str, wanted: Mapping[Choice, Scenario], seeds: Sequence[int], jobs: int
) -> dict[Choice, list[FlightOutcome]]:
    """The outcomes of flights with these seeds, of each choice."""
    points = {name: [flight.replace(seed=seed) for seed in seeds] for name, flight in wanted.items()}
    return {
        name: [*map(outcome, results)] for name, results in published.flown(study, points, jobs, flights.fly).items()
    }


def chosen(
    found: Mapping[Choice, Sequence[FlightOutcome]], mission: str, budget: float, controller: str
) -> Choice | None:
    """The policy that a controller flies within a budget; None if each one costs more, or leaves UAVs behind."""
    within: list[tuple[int, float, Choice]] = []
    for name, outcomes in found.items():
        free, kbit, arrived = np.mean(outcomes, axis=0)
        if name[:2] == (mission, controller) and kbit <= budget * MISSIONS[mission] and arrived >= ARRIVES:
            within.append((-free, kbit, name))
    return min(within)[-1] if within else None


def row_of(
    place: tuple[str, float, str], choice: Choice | None, ranked: Mapping[Choice, Sequence[FlightOutcome]]
) -> Row:
    """Row of a controller in the results."""
    outcomes = [] if choice is None else ranked[choice]
    return {
        **dict(zip(("mission", "budget_kbit", "controller"), place, strict=True)),
        "policy": NONE if choice is None else choice.policy,
        "free": [one.free for one in outcomes],
        "kbit": [one.kbit for one in outcomes],
        "arrived": [one.arrived for one in outcomes],
    }


# -- text ------------------------------------------------------------------------------------------------------------


def page(text: str, code: str, found: Sequence[Row]) -> str:
    """The page `text` with the ranking."""
    lines = [about(), "", *findings(found)]
    head = ("row", "policy", "kbit", "free, first seeds", "free, second seeds", "free of all, %")
    for mission, budget in product(MISSIONS, BUDGETS):
        title = f"### `{mission}`, {MISSIONS[mission]} UAVs, at most {budget:g} kbit a UAV"
        lines += ["", title, "", *table(head, map(_line, rank(found, mission, budget)))]
    return replaced(text, BEGIN, END, ["", *lines, "", published.flown_by(code), ""])


def about() -> str:
    """The method."""
    return (
        "Which controller is safest if all may send equally much? For each mission and budget, a controller flies the "
        f"policy that had the most free flights on {len(CHOICE)} seeds, among those whose mean payload is within the "
        "budget. The missions have their own radio. The rankings below are of "
        f"{len(FIRST)} other seeds ({FIRST[0]} to {FIRST[-1]}). {len(SECOND)} more seeds, which chose and ranked "
        f"nothing, test them ({SECOND[0]} to {SECOND[-1]}). Two controllers differ if McNemar's exact test says so, "
        "corrected after Holm for all pairs of a table. Intervals are those of Clopper and Pearson, 95 %. Written by "
        "`python -m meanflock.studies.equal_bits`; each flight is in "
        "[results/equal_bits.json](results/equal_bits.json)."
    )


def rank(found: Sequence[Row], mission: str, budget: float) -> list[Row]:
    """The rows of a table, the most free flights of the first seeds first; equal ones by their bits."""
    own = [row for row in found if (row["mission"], row["budget_kbit"]) == (mission, budget)]
    return sorted(own, key=lambda row: (not row["free"], -_first(row).sum(), sum(row["kbit"])))


def findings(found: Sequence[Row]) -> list[str]:
    """The pairs that differ on the first seeds, and whether the second seeds agree: of all tables, and of each."""
    texts = []
    differences = 0
    agreeing = 0
    for mission, budget in product(MISSIONS, BUDGETS):
        flew = [row for row in rank(found, mission, budget) if row["free"]]
        above = pairs(flew)
        agree = sum(int(_second(better).sum() > _second(worse).sum()) for better, worse in above)
        differences, agreeing = differences + len(above), agreeing + agree
        below: dict[str, list[str]] = {}
        for better, worse in above:
            below.setdefault(better["controller"], []).append(f"`{worse['controller']}`")
        order = "; ".join(f"`{better}` above {', '.join(others)}" for better, others in below.items())
        words = f"{order} ({agree} of {len(above)} agree)" if above else f"no two of {len(flew)} controllers differ"
        texts.append(f"- **`{mission}`, {budget:g} kbit a UAV**: {words}.")
    return [f"**Of {differences} differences, {agreeing} have the same sign on the second seeds.**", "", *texts]


def pairs(ranked: Sequence[Row]) -> list[tuple[Row, Row]]:
    """The pairs of rows, the better one first, that differ significantly on the first seeds."""
    every = [*combinations(ranked, 2)]
    rejected = marks.holm([marks.mcnemar(_first(one), _first(other)) for one, other in every])
    return [pair for pair, differs in zip(every, rejected, strict=True) if differs]


def _first(row: Row) -> NDArray[np.bool_]:
    return np.array(row["free"][: len(FIRST)], dtype=bool)


def _second(row: Row) -> NDArray[np.bool_]:
    return np.array(row["free"][len(FIRST) :], dtype=bool)


def _line(row: Row) -> tuple[str, ...]:
    if not row["free"]:
        return f"`{row['controller']}`", row["policy"], "", "", "", ""
    every = statistics.share(row["free"])
    halves = (f"{half.sum()} of {len(half)}" for half in (_first(row), _second(row)))
    share = f"{100 * every.value:.0f} ({100 * every.low:.0f}…{100 * every.high:.0f})"
    return f"`{row['controller']}`", f"`{row['policy']}`", f"{np.mean(row['kbit']):,.0f}", *halves, share


if __name__ == "__main__":
    process.main(main)
