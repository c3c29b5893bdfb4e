"""Writes what reproduction.md shows of the study: results/claims.json, results/map.json, the picture and the table.

    python docs/reproduction.py out/paper out/paper-slow out/paper-printed

The folders are what `meanflock paper`, and the same with `--scenario`, wrote. The words of the page are written by
hand; tests/groundstation/test_published.py holds its numbers to the two files.
"""

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from meanflock.groundstation.paper import regimes, statistics
from meanflock.groundstation.paper.figures import draw
from meanflock.groundstation.paper.store import load
from meanflock.groundstation.paper.view import View

DOCS = Path(__file__).parent
PAGE = DOCS / "reproduction.md"
OTHERS = ("paper-slow", "paper-printed")
OF_A_SCENARIO = ("verdict", "reason", "value", "ci95", "single_flights", "tests")
BEGIN, END = "<!-- table: docs/reproduction.py -->", "<!-- end of table -->"
METHODS = ("hjb", "mfgfl-h", "mfgfl-f", "mfgfl-hf")
Record = dict[str, Any]


def joined(paper: Sequence[Record], others: Mapping[str, Sequence[Record]]) -> list[Record]:
    """The records of the paper's scenario, each with what the others say of the same claim under `scenarios`."""
    by_id = {name: {record["id"]: record for record in records} for name, records in others.items()}
    return [
        {
            **record,
            "scenarios": {name: {key: of[record["id"]][key] for key in OF_A_SCENARIO} for name, of in by_id.items()},
        }
        for record in paper
    ]


def table(records: Sequence[Record]) -> list[str]:
    """A row a claim, a column a scenario: the verdict and, where one flight can say, in how many it holds."""
    lines = ["| id | figure | claim | rests on | paper | paper-slow | paper-printed |", "|---|---|---|---|---|---|---|"]
    for record in records:
        cells = [_cell(record), *(_cell(record["scenarios"][name]) for name in OTHERS)]
        said = f"{record['statement'].rstrip('.')} ({record['scenario']})"
        lines.append(f"| {' | '.join([record['id'], record['figure'], said, record['kind'], *cells])} |")
    return lines


def _cell(record: Mapping[str, Any]) -> str:
    single = record["single_flights"]
    return f"{record['verdict']}{'' if single is None else f', {single[0]} of {single[1]}'}"


def mapped(view: View) -> Record:
    """The map as plain values: every setting with its score, and those flown again with means and intervals."""
    found = regimes.places(view)
    again = {place.setting: place for place in regimes.places(view, regimes.FOUND)}
    return {
        "claims": sorted(found[0].held, key=lambda name: int(name[1:])),
        "settings": [
            {
                "setting": place.setting,
                "score": round(place.score, 3),
                "holds": {name: list(counts) for name, counts in place.held.items()},
                "never_arrived": round(place.never_arrived, 4),
            }
            for place in found
        ],
        "best": [place.setting for place in regimes.best(found)],
        "paper-slow": regimes.slow(found).setting,
        "paper-printed": regimes.printed(found).setting,
        "again": [
            {
                "setting": setting,
                "score": round(place.score, 3),
                "holds": {name: list(counts) for name, counts in place.held.items()},
                "never_arrived": round(place.never_arrived, 4),
                **_means(view, setting),
            }
            for setting, place in again.items()
        ],
    }


def _means(view: View, setting: str) -> Record:
    """Mean and interval by method; and in how many flights HF has the least energy."""
    frames = {m: view.runs.where(experiment=regimes.FOUND, setting=setting, method=m) for m in METHODS}
    result: Record = {"seeds": len(frames["mfgfl-hf"])}
    for metric in ("energy_mean_J", "t_avg_censored_s", "collisions_mission", "speed_max_m_s"):
        result[metric] = {m: _estimate(list(frame.by_seed(metric).values())) for m, frame in frames.items()}
    energy = [frame.by_seed("energy_mean_J") for frame in frames.values()]
    seeds = sorted(set.intersection(*(set(of) for of in energy)))
    result["hf_cheapest"] = [sum(energy[3][s] < min(of[s] for of in energy[:3]) for s in seeds), len(seeds)]
    return result


def _estimate(values: list[float]) -> list[float]:
    found = statistics.mean(values)
    return [round(number, 4) for number in (found.value, found.low, found.high)]


def main(paper: Path, *others: Path) -> None:
    """Writes all of it."""
    read = {
        name: json.loads((out / "claims.json").read_text(encoding="utf-8"))
        for name, out in zip(OTHERS, others, strict=True)
    }
    records = joined(json.loads((paper / "claims.json").read_text(encoding="utf-8")), read)
    (DOCS / "results/claims.json").write_text(
        json.dumps(records, indent=1, ensure_ascii=False) + "\n", encoding="utf-8"
    )
    results = load(paper)
    described = json.dumps(mapped(View.of(results)), indent=1, ensure_ascii=False)
    (DOCS / "results/map.json").write_text(described + "\n", encoding="utf-8")
    draw(results, DOCS / "pictures/paper", ["map"])
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    after = rest.partition(END)[2]
    PAGE.write_text(before + "\n".join([BEGIN, "", *table(records), "", END]) + after, encoding="utf-8")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
