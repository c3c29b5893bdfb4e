"""Writes docs/results/claims.json and map.json, the figures, and the generated parts of reproduction.md.

    python -m research.reproduction.page out/paper out/paper-slow out/paper-printed out/paper-exchanged
    python -m research.reproduction.page                    # the page again, from the two files

`meanflock paper` writes the first folder, and `meanflock paper --scenario` the others. The rest of the page is written
by hand; tests/reproduction/test_published.py compares the page with the two files.
"""

import json
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binom

from meanflock.results import statistics
from meanflock.studies import markdown, published
from meanflock.studies.leaderboard.front import front
from meanflock.swarm.scenario import Scenario
from research.reproduction import claims, regimes, report
from research.reproduction.figures import draw
from research.reproduction.measure import load_measured
from research.reproduction.tables import View, load
from research.reproduction.verdict import (
    BY_CONSTRUCTION,
    NOT_REFUTED,
    NOT_REPRODUCED,
    NOT_TESTABLE,
    REPRODUCED,
    UNDECIDED,
    shares,
)

DOCS = Path(__file__).parents[2] / "docs"
PAGE = DOCS / "reproduction.md"
CHOSEN = ("paper-slow", "paper-printed")  # by the map's search
OTHERS = (*CHOSEN, "paper-exchanged")
OF_A_SCENARIO = ("verdict", "reason", "value", "ci95", "single_flights", "tests")
BEGIN, END = "<!-- table: research/reproduction/page.py -->", "<!-- end of table -->"
FINDINGS = "<!-- findings: research/reproduction/page.py -->", "<!-- end of findings -->"
RUN = "<!-- {}: research/reproduction/page.py -->"  # mark of a table about the flights, by its name
CLAIMS = len(claims.load())
METHODS = ("hjb", "mfgfl-h", "mfgfl-f", "mfgfl-hf")
Record = dict[str, Any]


def joined(paper: Sequence[Record], others: Mapping[str, Sequence[Record]]) -> list[Record]:
    """The records of the paper's scenario; `scenarios` has those of the same claim in the other scenarios."""
    by_id = {name: {record["id"]: record for record in records} for name, records in others.items()}
    return [
        {
            **record,
            "scenarios": {
                name: {key: found[record["id"]][key] for key in OF_A_SCENARIO} for name, found in by_id.items()
            },
        }
        for record in paper
    ]


def table(records: Sequence[Record]) -> list[str]:
    """A row for each claim, a column for each scenario: the verdict, and the number of single flights that hold."""
    lines = [f"| id | figure | claim | rests on | paper | {' | '.join(OTHERS)} |", "|---|---|---|---|---|---|---|---|"]
    for record in records:
        cells = [_cell(record), *(_cell(record["scenarios"][name]) for name in OTHERS)]
        words = f"{record['statement'].rstrip('.')} ({record['scenario']})"
        lines.append(f"| {' | '.join([record['id'], record['figure'], words, record['kind'], *cells])} |")
    return lines


def _cell(record: Mapping[str, Any]) -> str:
    single = record["single_flights"]
    if record["reason"].startswith("no data"):
        return "not flown"
    return f"{record['verdict']}{'' if single is None else f', {single[0]} of {single[1]}'}"


def findings(records: Sequence[Record], described: Record) -> list[str]:
    """The findings of the page, with all their numbers from the two files."""
    by_id = {record["id"]: record for record in records}
    scores = sorted((place["score"] for place in described["settings"]), reverse=True)
    ranked = sorted(
        (p["score"] for p in described["settings"] if p["never_arrived"] < regimes.FEW_ARRIVE), reverse=True
    )
    default = next(place["score"] for place in described["settings"] if not place["setting"])
    counts = {name: counted(records, name) for name in ("paper", *OTHERS)}
    lucky = f"C13 holds in {_flights(by_id['C13'], 'paper-printed')} single flights of this scenario"
    printed, usual = (described["top_speeds"][name]["hjb"] for name in ("paper-printed", "paper"))
    equal = {name: _ratio(by_id["O1"], name) for name in ("t_avg_censored_s", "energy_mean_J")}
    of_motion = f"{len(described['claims'])} claims about motion, each counted by its share of flights"
    lines = [
        f"**The default reproduces {counts['paper'][REPRODUCED]} of {CLAIMS} claims**; {tally(counts['paper'])}. "
        + " ".join(f"`{name}` reproduces {counts[name][REPRODUCED]}; {tally(counts[name])}." for name in OTHERS),
        f"**No setting reproduces the paper.** The best of {len(scores)} settings scores {ranked[0]:.1f} of "
        f"{of_motion}. The tenth best scores {ranked[9]:.1f}, and the default {default:.1f}. {flown_again(described)}",
        "**The main claim about energy holds with slow steering** (`paper-slow`: L_v = 80 m/s, κ = 0.04). Sharing both "
        f"models costs the least energy of all methods in {_flights(by_id['O5'], 'paper-slow')} fresh flights "
        f"({_energies(by_id['O5'], 'paper-slow')}), and at the default in {_flights(by_id['O5'], None)} "
        f"({_energies(by_id['O5'], None)}). It saves 16 % compared with every other method (C13) in "
        f"{_flights(by_id['C13'], 'paper-slow')} and {_flights(by_id['C13'], None)} flights.",
        shorter_trips(by_id),
        "**The printed polynomial gives the paper's top speed** (`paper-printed`: its coefficients kept, κ = 0, "
        f"L_r = 300 m, L_v = 60 m/s). With `hjb` it is {_speed(printed)} m/s in the median of {printed['n']} flights; "
        f"the paper has 16.2, and the default {_speed(usual)}. The fastest UAV reached {printed['fastest']:,.0f} m/s, "
        f"because a learner diverged. {lucky}.",
        "**The length of a round makes the difference, not the density.** With equal rounds, trips with both models "
        f"shared take {equal['t_avg_censored_s']} times as long as with the value model shared, and "
        f"{equal['energy_mean_J']} times the energy (O1). Velocities are not better aligned: φ_A is "
        f"{_ratio(by_id['O2'], 'phi_A_tavg')} times as large (O2).",
        "**The printed cost does not keep UAVs apart.** At the default, "
        f"{_flights(by_id['C8'], None)} flights with both models shared were free of collisions (C8). A repulsion "
        "added to the command keeps them apart with slow steering: "
        f"{_share(by_id['O4'], 'paper-slow')} flights of `paper-slow` were free, and {_share(by_id['O4'], None)} at "
        "the default (O4).",
    ]
    gaps = described["optimality"]
    moving = ", ".join(f"`{method}` {gaps[method]['cost_moving'][0]:.1f}" for method in METHODS)
    whole = ", ".join(f"{gaps[method]['cost'][0]:.1f}" for method in METHODS)
    above = ", ".join(f"{gaps[method]['energy_over_least']:.1f}" for method in METHODS)
    lines.append(
        f"**No method is near the optimum.** The cost of a flight is {moving} times that of the optimal flight of one "
        f"UAV in the same time. (With the last 5 m, which no UAV flies, the ratios are {whole}.) The motion energy is "
        f"{above} times the least possible in that time ({gaps['seeds']} seeds)."
    )
    lines = [f"- {line}" for line in lines]
    return lines


def tally(counts: Mapping[str, int]) -> str:
    """Counts of every verdict but "reproduced"."""
    return (
        f"{counts[BY_CONSTRUCTION]} hold by construction, {counts[NOT_REFUTED]} are not refuted, "
        f"{counts[NOT_REPRODUCED]} are not reproduced, {counts[UNDECIDED]} are undecided and "
        f"{counts[NOT_TESTABLE]} cannot be tested"
    )


def shorter_trips(by_id: Mapping[str, Record]) -> str:
    """The reason for the low energy of sharing both models in `paper-slow`, and the limits of the comparison."""
    slow = {name: _of(by_id[name], "paper-slow") for name in ("C2", "C17", "C22", "O9")}
    (trip,) = slow["C17"]["tests"]
    speed = next(test for test in slow["C22"]["tests"] if test["what"].endswith("− mfgfl-h"))
    energy = next(test for test in slow["O9"]["tests"] if test["what"].endswith("− mfgfl-h"))
    (saved,) = slow["C2"]["tests"]
    other = saved["what"].split(" against ")[1].split(" at ")[0]
    absent = slow["C2"]["value"][f"never_arrived, {other}"]
    held, flown = slow["O9"]["single_flights"]
    return (
        "**With slow steering, shorter trips save the energy, not slower flight.** Trips take "
        f"{_interval(trip)} times as long as with the value model shared (C17), at mean speeds that differ by "
        f"{_interval(speed)} m/s (C22). Over the common 300 s sharing both models saves nothing compared with sharing "
        f"the value model: the difference is {_interval(energy)} J. It costs the least of all methods in {held} of "
        f"{flown} flights (O9). "
        f"The saving of {100 * saved['value']:.0f} % that decides “up to a quarter” (C2) is a comparison with "
        f"`{other}`, and {100 * absent:.0f} % of its UAVs never arrive."
    )


def flown_again(described: Record) -> str:
    """The scores of the ten best settings with fresh seeds."""
    again = described["again"]
    if not again:
        return "The ten best have not flown again."
    scores = [place["score"] for place in again]
    cheapest = {place["setting"]: place["hf_cheapest"] for place in again}
    slow = cheapest.pop(described["paper-slow"])
    most = max(held for held, _ in cheapest.values())
    return (
        f"With {again[0]['seeds']} fresh seeds the ten best score {min(scores):.1f} to {max(scores):.1f}: their luck "
        "with two seeds is gone, and comparisons with `hjb` count too. Sharing both models has the least energy "
        f"of all methods in {slow[0]} of {slow[1]} flights of `paper-slow`, and in at most {most} flights of any other "
        "setting."
    )


def counted(records: Sequence[Record], name: str) -> Mapping[str, int]:
    """Verdicts of the paper's claims in a scenario."""
    return Counter(_of(record, name)["verdict"] for record in records if record["id"].startswith("C"))


def _of(record: Record, name: str | None) -> Record:
    other: Record = record if name in (None, "paper") else record["scenarios"][name]
    return other


def _flights(record: Record, name: str | None) -> str:
    single = _of(record, name)["single_flights"]
    return f"{single[0]} of {single[1]}" if single else "none"


def _share(record: Record, name: str | None) -> str:
    """The number of flights that a claim about a share counts, of all."""
    (test,) = _of(record, name)["tests"]
    return f"{round(test['value'] * test['seeds'])} of {test['seeds']}"


def _energies(record: Record, name: str | None) -> str:
    values = _of(record, name)["value"]
    return ", ".join(f"`{method}` {values[method]:.1f}" for method in METHODS) + " J"


def _speed(speeds: Record) -> str:
    median, low, high = speeds["median"]
    return f"{median:.1f} [{low:.1f}, {high:.1f}]"


def _ratio(record: Record, metric: str) -> str:
    return _interval(next(test for test in record["tests"] if test["what"].startswith(metric)))


def _interval(test: Record) -> str:
    low, high = test["ci95"]
    return f"{test['value']:.2f} [{low:.2f}, {high:.2f}]".replace("-", "−")


def mapped(view: View) -> Record:
    """The map as plain values: every setting with its score, and those flown again with means and intervals."""
    found = regimes.places(view)
    again = regimes.places(view, regimes.FOUND)
    return {
        "claims": sorted(found[0].held, key=lambda name: int(name[1:])),
        "settings": [_plain(place) for place in found],
        "best": [place.setting for place in regimes.best(found)],
        "paper-slow": regimes.slow(found).setting,
        "paper-printed": regimes.printed(found).setting,
        "again": [{**_plain(place), **_means(view, place.setting)} for place in again],
    }


def _plain(place: regimes.MapPoint) -> Record:
    return {
        "setting": place.setting,
        "score": round(place.score, 3),
        "holds": {name: list(counts) for name, counts in place.held.items()},
        "never_arrived": round(place.never_arrived, 4),
    }


def top_speeds(view: View) -> Record:
    """By method: the median top speed of the flights of S0 with its exact interval, m/s, and the fastest.

    The mean is useless, because one learner of a thousand diverges.
    """
    found: Record = {}
    for method in METHODS:
        speeds = np.sort(list(view.runs.where(experiment="s0", method=method).by_seed("speed_max_m_s").values()))
        low = int(binom.ppf(0.025, len(speeds), 0.5))  # so many may be below the median and so many above it
        ends = (speeds[low - 1], speeds[len(speeds) - low]) if low else (-np.inf, np.inf)
        median = [round(float(number), 4) for number in (np.median(speeds), *ends)]
        found[method] = {"n": len(speeds), "median": median, "fastest": round(float(speeds[-1]), 4)}
    return found


def optimality(measured: Mapping[str, Sequence[float]], records: Sequence[Record]) -> Record:
    """By method: cost over the optimum of one UAV, with and without the distance left at arrival, and the published
    motion energy over the least energy of a flight of the same time."""
    by_id = {record["id"]: record for record in records}
    energies, times = by_id["C39"]["value"], by_id["C41"]["value"] | by_id["C30"]["value"]
    least = front(Scenario(), np.array(Scenario().start.centre))
    result: Record = {"seeds": len(measured["gap_hjb"])}
    for method in METHODS:
        trip = times.get(f"{method}, σ = 0.1") or times[f"t_avg_censored_s, {method}, N = 25"]
        result[method] = {
            "cost": _estimate(list(measured[f"gap_{method}"])),
            "cost_moving": _estimate(list(measured[f"gap_{method}_moving"])),
            "energy_over_least": round(energies[f"{method}, σ = 0.1"] / least.least_J(trip), 3),
        }
    return result


def _means(view: View, setting: str) -> Record:
    """Mean and interval by method, and the number of flights in which mfgfl-hf has the least energy."""
    frames = {m: view.runs.where(experiment=regimes.FOUND, setting=setting, method=m) for m in METHODS}
    result: Record = {"seeds": len(frames["mfgfl-hf"])}
    for metric in ("energy_mean_J", "t_avg_censored_s", "collisions_mission", "speed_max_m_s"):
        result[metric] = {m: _estimate(list(frame.by_seed(metric).values())) for m, frame in frames.items()}
    energy = [frame.by_seed("energy_mean_J") for frame in frames.values()]
    seeds = sorted(set.intersection(*map(set, energy)))
    result["hf_cheapest"] = [sum(energy[3][s] < min(other[s] for other in energy[:3]) for s in seeds), len(seeds)]
    return result


def _estimate(values: list[float]) -> list[float]:
    found = statistics.mean(values)
    return [round(number, 4) for number in (found.value, found.low, found.high)]


def main(*folders: Path) -> None:
    """Writes the results of the folders, where there are any, and the page; without folders, not what tells of the
    flights alone."""
    page = PAGE.read_text(encoding="utf-8")
    if folders:
        write_results(*folders)
        for name, lines in of_flights(folders[0]).items():
            page = markdown.replaced(page, RUN.format(name), END, ["", *lines, ""])
    records, described = (
        json.loads((DOCS / "results" / name).read_text(encoding="utf-8")) for name in ("claims.json", "map.json")
    )
    for (begin, end), lines in (((BEGIN, END), table(records)), (FINDINGS, findings(records, described))):
        page = markdown.replaced(page, begin, end, ["", *lines, ""])
    PAGE.write_text(page, encoding="utf-8")


def write_results(paper: Path, *others: Path) -> None:
    """Writes both files and the picture of the map."""
    read = {
        name: json.loads((out / "claims.json").read_text(encoding="utf-8"))
        for name, out in zip(OTHERS, others, strict=True)
    }
    records = joined(json.loads((paper / "claims.json").read_text(encoding="utf-8")), read)
    (DOCS / "results/claims.json").write_text(
        json.dumps(records, indent=1, ensure_ascii=False) + "\n", encoding="utf-8"
    )
    results = load(paper)
    described = mapped(View.from_results(results)) | {"optimality": optimality(load_measured(paper), records)}
    described["top_speeds"] = {
        name: top_speeds(View.from_results(load(out)))
        for name, out in zip(("paper", *OTHERS), (paper, *others), strict=True)
    }
    (DOCS / "results/map.json").write_text(json.dumps(described, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    for path in draw(results, DOCS / "pictures/paper"):
        if path.suffix == ".svg":  # the page shows the PNG
            path.unlink()


def of_flights(paper: Path) -> dict[str, list[str]]:
    """Lines about the flights of the paper's scenario, by the names of their marks."""
    results = load(paper)
    view = View.from_results(results, load_measured(paper))
    return {
        "how it was run": [published.flown_by(report.versions(view)), "", *markdown.table(*report.how_run(view))],
        "diverged": markdown.table(*report.diverged(view)),
        "theory": markdown.table(*report.theory(view)),
        "open parameters": markdown.table(*report.open_parameters(shares(results))),
    }


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
