"""Flies ways of sharing a model against each other, and writes the tables of federation.md.

python -m research.federation          # 1,950 flights; a quarter of an hour on two cores
python -m research.federation --page   # the tables again, from docs/results/federation.json
"""

import math
import runpy
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from rich.progress import track

from meanflock.net import process
from meanflock.results import statistics
from meanflock.studies import published
from meanflock.studies.leaderboard import missions
from meanflock.studies.leaderboard.rows import BoardRow
from meanflock.studies.markdown import table, with_parts
from meanflock.swarm import plugins
from meanflock.swarm.scenario import Scenario

EXAMPLES = published.DOCS.parent / "examples"
PAGE = published.DOCS / "federation.md"
RESULTS = published.DOCS / "results" / "federation.json"
SEEDS = range(192001, 192031)  # seeds that were not used for tuning
ECBF = {"filter.kind": "ecbf"}
NEIGHBOURS = {"federation.topology": "neighbours"}
INT8 = {"federation.payload": "int8"}


def _threshold(value: float) -> dict[str, Any]:
    return {"federation.upload_threshold": value}


WAYS: dict[str, dict[str, Any]] = {  # of `fed-lspi`: name in the tables → settings; the first is the reference
    "leader": {},
    "leader, 0.03, int8": _threshold(0.03) | INT8,
    "neighbours": NEIGHBOURS,
    "neighbours, 0.03": NEIGHBOURS | _threshold(0.03),
    "neighbours, 0.03, int8": NEIGHBOURS | _threshold(0.03) | INT8,
    "neighbours, 0.1, int8": NEIGHBOURS | _threshold(0.1) | INT8,
}
CALM = ("paper", "unknown", "windy", "lossy")
TROUBLES: dict[str, dict[str, Any]] = {
    "UAV 0, which leads, is killed at 20 s": {"faults": [{"kind": "kill", "tick": 200, "uavs": [0]}]},
    "a fifth of the uploads has the wrong sign": {"federation.byzantine_fraction": 0.2},
    "the same, with the rule `median`": {"federation.byzantine_fraction": 0.2, "federation.aggregation": "median"},
    "uploads reach 2 m": {"federation.range_m": 2.0},
}
TROUBLED = {"leader": {}, "neighbours": NEIGHBOURS}
SPARING: dict[str, dict[str, Any]] = {  # of `mfgfl-hf` on `paper`: fewer uploads at random, or by the threshold
    "fraction 0.8": {},
    "fraction 0.4": {"federation.fraction": 0.4},
    "fraction 0.2": {"federation.fraction": 0.2},
    "threshold 0.1": _threshold(0.1),
    "threshold 0.2": _threshold(0.2),
    "threshold 0.4": _threshold(0.4),
}
SLOW = {"radio.coherence_time_s": 0.5, "radio.latency_threshold_slots": 15}  # uploads take up to 7.5 s
LATE: dict[str, dict[str, Any]] = {
    "leader": SLOW,
    "leader, deadline 3 s": SLOW | {"federation.deadline": 3.0},
    "leader, deadline 1.5 s": SLOW | {"federation.deadline": 1.5},
    "neighbours, deadline 1.5 s": SLOW | NEIGHBOURS | {"federation.deadline": 1.5},
}
MIXED = {"vehicle.model": "mixed-drag", "federation.fraction": 1.0, "federation.fragment": 3}
LEFT: dict[str, dict[str, dict[str, Any]]] = {  # what meanflock leaves out: mission → name → settings
    **{
        mission: {
            "leader": {},
            "momentum at the leader": {"federation.aggregation": "momentum"},
            "FedAdam at the leader": {"federation.aggregation": "fedadam", "federation.options": {"eta": 0.4}},
            "the last upload of everybody": {"federation.aggregation": "last-upload"},
            "private, ε = 9": {"federation.aggregation": "private", "federation.options": {"epsilon": 9.0}},
            "private, ε = 2": {"federation.aggregation": "private", "federation.options": {"epsilon": 2.0}},
        }
        for mission in ("unknown", "lossy")
    },
    "slow radio": {
        "deadline 1.5 s": SLOW | {"federation.deadline": 1.5},
        "the same, late uploads count less": SLOW | {"federation.deadline": 1.5, "federation.aggregation": "aged"},
    },
    "paper, mixed drag": dict.fromkeys(("mfgfl-hf", "mfgfl-hf-scaffold"), MIXED),
}
MISSIONS = {"slow radio": "unknown", "paper, mixed drag": "paper"} | dict.fromkeys(TROUBLES, "unknown")
# Of a table, or of a way that is a controller; all others fly `fed-lspi`.
METHODS = {"sparing": "mfgfl-hf", "mfgfl-hf": "mfgfl-hf", "mfgfl-hf-scaffold": "mfgfl-hf-scaffold"}
MARKS = {"calm": "ways", "trouble": "troubles", "late": "late", "sparing": "sparing", "left": "left"}  # by table
PLUGINS = (Path(__file__).with_name("left_out.py"), *(EXAMPLES / f"{name}.py" for name in ("momentum", "fedadam")))
KEPT = (
    "t_avg_censored_s",
    "energy_mean_J",
    "collisions_all",
    "arrived",
    "uavs",
    "uploads_silent",
    "uploads_late",
    "rounds_isolated",
)
MODELS = ("uplink", "relay", "broadcast")  # kinds of traffic
Case = tuple[str, str, str]  # table, mission or trouble, and way
Flight = dict[str, Any]


def main() -> None:
    """Fly the cases of the tables, unless `--page` is set, and write the tables."""
    given = published.options(__doc__, page=True).parse_args()
    if not given.page:
        plugins.load_files(PLUGINS)
        points = {case: [scenario(case, seed) for seed in SEEDS] for case in cases()}
        found = published.flown("federation", points, given.jobs)
        rows = [
            flight_of(case, seed, summary)
            for case, summaries in found.items()
            for seed, summary in zip(SEEDS, summaries, strict=True)
        ]
        published.write_rows(RESULTS, [*rows, *classified()])
    published.write_page(PAGE, page, RESULTS)


def page(text: str, code: str, flights: Sequence[Flight]) -> str:
    """The page `text` with the tables of these flights."""
    return with_parts(text, {"code": [published.flown_by(code)], **tables(flights)})


def cases() -> list[Case]:
    """Every case, in the order of the tables."""
    return [
        *(("calm", mission, way) for mission in CALM for way in WAYS),
        *(("trouble", trouble, way) for trouble in TROUBLES for way in TROUBLED),
        *(("late", "unknown", way) for way in LATE),
        *(("sparing", "paper", way) for way in SPARING),
        *(("left", where, way) for where, ways in LEFT.items() for way in ways),
    ]


def scenario(case: Case, seed: int) -> Scenario:
    """One flight of a case: behind the filter, with the acceleration limit of the leaderboard."""
    kind, where, way = case
    ways = {"calm": WAYS, "trouble": TROUBLED, "late": LATE, "sparing": SPARING, "left": LEFT.get(where, {})}
    method = METHODS.get(kind) or METHODS.get(way, "fed-lspi")
    row = BoardRow(way, method, settings=ECBF | ways[kind][way] | TROUBLES.get(where, {}))
    mission = MISSIONS.get(where, where)
    (found,) = missions.chosen([mission])
    return row.scenario(found.table(), seed, mission)


def flight_of(case: Case, seed: int, summary: Mapping[str, Any]) -> Flight:
    """Row of one flight in the results."""
    traffic = summary["radio"]["traffic"]
    bits, cost = summary["payload_bits"], summary["diagnostics"].get("tracking_cost")
    return {
        "table": case[0],
        "where": case[1],
        "way": case[2],
        "seed": seed,
        "kbit": sum(bits[kind] for kind in MODELS) / 1e3,
        "kbit_by_kind": {kind: bits[kind] / 1e3 for kind in MODELS},
        "airtime_s": sum(traffic[kind]["airtime_s"] for kind in MODELS),
        "tracking": None if cost is None else cost / summary["uavs"],
        **{name: summary[name] for name in KEPT},
    }


def tables(flights: Sequence[Flight]) -> dict[str, list[str]]:
    """The tables of the page, by their marks."""
    found: dict[str, list[str]] = {}
    for kind, mark in MARKS.items():
        rows = []
        for where in dict.fromkeys(flight["where"] for flight in flights if flight["table"] == kind):
            here = [flight for flight in flights if (flight["table"], flight["where"]) == (kind, where)]
            ways = {
                way: [one for one in here if one["way"] == way] for way in dict.fromkeys(one["way"] for one in here)
            }
            first, *_ = ways.values()
            rows += [_row(where, way, flown, first) for way, flown in ways.items()]
        found[mark] = table(_HEAD if kind != "sparing" else _HEAD[:4] + _HEAD[5:], map(_without(kind), rows))
    return found | {
        "drift": _drifts(),
        "digits": _digits([flight for flight in flights if flight["table"] == "digits"]),
    }


def classified() -> list[Flight]:
    """Rows of the flights of examples/classifier.py."""
    example = runpy.run_path(str(EXAMPLES / "classifier.py"))
    return [
        {"table": "digits", "where": str(uavs), "way": way, "seed": seed, "accuracy": accuracy, "kbit": bits / 1e3}
        for uavs, way, seed in track(list(product((10, 25), example["WAYS"], SEEDS[:10])), "classifier")
        for accuracy, _, bits in example["fly"](way, uavs, 40, seed)[-1:]
    ]


def _digits(flights: Sequence[Flight]) -> list[str]:
    """Test accuracy and bits of the classifier, a row for each number of UAVs."""
    ways = list(dict.fromkeys(flight["way"] for flight in flights))
    rows = []
    for uavs in dict.fromkeys(flight["where"] for flight in flights):
        cells = [f"{uavs} UAVs"]
        for way in ways:
            here = [flight for flight in flights if (flight["where"], flight["way"]) == (uavs, way)]
            accuracy = statistics.mean([100.0 * flight["accuracy"] for flight in here])
            mbit = statistics.mean([flight["kbit"] / 1e3 for flight in here]).value
            cells.append(f"{accuracy.shown('.1f')} %" + (f", {mbit:.1f} Mbit" if mbit else ""))
        rows.append(cells)
    return table(["", *ways], rows)


DRIFT_LOSSES = (0.0, 0.03, 0.1, 0.3, 0.5)


def drift(loss: float, rounds: int = 30, uavs: int = 25, trials: int = 400) -> float:
    """Drift of the mean of numbers that UAVs average with those that they receive, each link lossy by itself.

    Returns:
        Its root mean square over trials, in units of the spread before the first round.
    """
    draw = np.random.default_rng(92001)
    drifts = []
    for _ in range(trials):
        start = values = draw.standard_normal(uavs)
        for _ in range(rounds):
            received = draw.random((uavs, uavs)) >= loss
            np.fill_diagonal(received, True)
            values = received @ values / received.sum(axis=1)
        drifts.append((values.mean() - start.mean()) / start.std())
    return float(np.sqrt(np.mean(np.square(drifts))))


def _drifts() -> list[str]:
    return table(
        ("lost links", "drift of the mean"), [(f"{100 * loss:g} %", f"{drift(loss):.3f}") for loss in DRIFT_LOSSES]
    )


_HEAD = ("", "way", "models, kbit", "airtime of models, s", "tracking", "Δ time, s", "Δ energy, J", "free", "arrived")


def _without(kind: str) -> Any:
    """Cells of a row, without tracking for methods that do not track."""
    return lambda row: row if kind != "sparing" else row[:4] + row[5:]


def _row(where: str, way: str, flown: Sequence[Flight], first: Sequence[Flight]) -> tuple[str, ...]:
    """A line of a table; differences and ratios are to the first way, paired by seed, with their 95 % intervals."""

    def column(name: str, flights: Sequence[Flight] = flown) -> list[float]:
        return [float(flight[name]) for flight in flights]

    def against(name: str) -> str:
        if flown is first:
            return f"{statistics.mean(column(name)).value:.4g}"
        estimate = statistics.difference(column(name), column(name, first))
        return f"{estimate.value:+.2g} [{estimate.low:.2g}, {estimate.high:.2g}]"

    free = sum(flight["collisions_all"] == 0 for flight in flown)
    arrived = sum(flight["arrived"] for flight in flown), sum(flight["uavs"] for flight in flown)
    return (
        where,
        way,
        _kbit(flown),
        f"{statistics.mean(column('airtime_s')).value:.3f}",
        ""
        if flown[0]["tracking"] is None
        else _tracking(column("tracking"), column("tracking", first), flown is first),
        against("t_avg_censored_s"),
        against("energy_mean_J"),
        f"{free} of {len(flown)}",
        f"{arrived[0]} of {arrived[1]}",
    )


def _kbit(flown: Sequence[Flight]) -> str:
    """Mean bits of models, and those of each kind that was sent, where the rows have them."""
    text = f"{statistics.mean([flight['kbit'] for flight in flown]).value:,.1f}"
    if not all("kbit_by_kind" in flight for flight in flown):
        return text
    means = {kind: statistics.mean([flight["kbit_by_kind"][kind] for flight in flown]).value for kind in MODELS}
    return f"{text} ({', '.join(f'{kind} {mean:,.1f}' for kind, mean in means.items() if mean)})"


def _tracking(own: Sequence[float], first: Sequence[float], is_first: bool) -> str:
    """The geometric mean of tracking costs, or its ratio to that of the first way, paired by seed."""
    logarithms = [math.log(value) for value in own]
    if is_first:
        return f"{math.exp(statistics.mean(logarithms).value):.3g}"
    ratio = statistics.difference(logarithms, [math.log(value) for value in first])
    return f"× {math.exp(ratio.value):.2f} [{math.exp(ratio.low):.2f}, {math.exp(ratio.high):.2f}]"


if __name__ == "__main__":
    process.main(main)
