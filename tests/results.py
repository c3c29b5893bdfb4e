"""Published results by name: numbers of docs/results, of the record of the benchmarks, and of tables of the pages."""

import json
import math
import tomllib
from collections.abc import Iterator, Sequence
from functools import cache, reduce
from operator import getitem
from pathlib import Path
from typing import Any

import numpy as np

import meanflock as mf
from benchmarks import rounds, scaling, store
from meanflock.channel import link
from meanflock.groundstation import statistics
from meanflock.kernels.mean_field.layout import MODEL_FLOATS
from meanflock.studies import federation, published, tuning
from meanflock.studies.frontier import record as frontier
from meanflock.studies.leaderboard import board
from meanflock.swarm.scenario import load
from reproduction.page import counted
from reproduction.verdict import BY_CONSTRUCTION, NOT_REFUTED, NOT_REPRODUCED, NOT_TESTABLE, REPRODUCED, UNDECIDED

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "docs" / "results"
QUIET = "neighbours, 0.03, int8"
NEAR = ("trouble", "uploads reach 2 m", "leader")
RATIO = "wire bytes / payload bytes"
LSPI = ("fed-lspi", "fed-lspi-data", "fed-lspi-alone")
OUTAGES = "outages, %"
PAPER = "the paper's"  # of the radios of clusters


@cache
def leaderboard() -> board.Board:
    return board.read(RESULTS / board.FILE)


def standing(mission: str, row: str) -> board.Standing:
    course = next(course for course in leaderboard().courses if course.name == mission)
    return next(each for each in course.standings if each.name == row)


def free_flights(row: str, missions: Sequence[str]) -> int:
    return sum(int(standing(mission, row).column("free").sum()) for mission in missions)


def median_of(mission: str, row: str, measure: str) -> float:
    return float(np.median(standing(mission, row).column(measure)))


def shared_bits(mission: str, row: str, other: str) -> float:
    return median_of(mission, row, "kbit") / median_of(mission, other, "kbit")


@cache
def flown() -> list[dict[str, Any]]:
    return published.read_rows(federation.RESULTS)[1]


def column(name: str, *case: str) -> np.ndarray:
    """A number of the flights of a table, mission and way of the page about federations."""
    rows = [row for row in flown() if (row["table"], row["where"], row["way"]) == case]
    return np.array([row[name] for row in rows], dtype=np.float64)


def mixed(name: str, way: str = "mfgfl-hf") -> np.ndarray:
    return column(name, "left", "paper, mixed drag", way)


def share(name: str, where: str, way: str = QUIET) -> float:
    return float(column(name, "calm", where, way).sum() / column(name, "calm", where, "leader").sum())


def tracking(kind: str, where: str, way: str, first: str = "leader") -> statistics.Estimate:
    """Ratio of tracking costs, paired by seed, with its interval."""
    own, others = (np.log(column("tracking", kind, where, each)) for each in (way, first))
    found = statistics.difference(own, others)
    return statistics.Estimate(*(math.exp(value) for value in (found.value, found.low, found.high)), found.n)


def ratio(kind: str, where: str, way: str, first: str = "leader") -> str:
    found = tracking(kind, where, way, first)
    return f"{found.value:.2f} [{found.low:.2f}, {found.high:.2f}]"


def per_cent(found: statistics.Estimate) -> str:
    """What a cost rises or falls by, %."""
    values = sorted(abs(100.0 * (value - 1.0)) for value in (found.low, found.high))
    return f"{abs(100.0 * (found.value - 1.0)):.0f} % [{values[0]:.0f}, {values[1]:.0f}]"


def spared(way: str) -> list[str]:
    """Seconds and J that a way of the paper's learner saves, and its kbit."""
    usual, own = (
        [column(name, "sparing", "paper", each).mean() for name in ("t_avg_censored_s", "energy_mean_J", "kbit")]
        for each in ("fraction 0.8", way)
    )
    return [f"{usual[0] - own[0]:.2g}", f"{usual[1] - own[1]:.2g}", two_digits(own[2])]


@cache
def record(path: Path = store.LATEST) -> dict[str, Any]:
    record: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return record


def median(race: str, name: str) -> float:
    return next(float(one["median"]) for one in record()["races"][race]["figures"] if one["name"] == name)


def two_digits(value: float) -> str:
    return f"{float(f'{value:.2g}'):.0f}"


def one_digit(value: float) -> str:
    return f"{float(f'{value:.1g}'):.0f}"


@cache
def fitted() -> scaling.Fit:
    return scaling.fit(scaling.samples_of(record(scaling.RECORD)))


def of_fit(name: str) -> float:
    return 1e3 * float(fitted().coefficients[list(scaling.TERMS).index(name)])  # µs


def rows_of(page: str, mark: str) -> Iterator[dict[str, str]]:
    """Rows of a table that a study wrote after a mark."""
    text = (ROOT / page).read_text(encoding="utf-8").partition(f"<!-- {mark} -->")[2].partition("<!-- end")[0]
    head, _, *lines = [line for line in text.splitlines() if line.startswith("|")]
    names = [cell.strip() for cell in head.strip("|").split("|")]
    for line in lines:
        yield dict(zip(names, [cell.strip() for cell in line.strip("|").split("|")], strict=True))


def sent(method: str, payload: str, name: str, table: str = "flights") -> str:
    rows = rows_of("docs/communication.md", table)
    return next(row[name] for row in rows if (row["method"], row["payload"]) == (f"`{method}`", payload))


def transmission(method: str, payload: str, name: str) -> float:
    return float(sent(method, payload, name, "transmissions").replace(",", ""))


def envelope_bytes() -> float:
    ratio, bits = (transmission("mfgfl-h", "float32", name) for name in (RATIO, "bits"))
    return (ratio - 1.0) * bits / 8.0


def kbit(method: str, payload: str) -> float:
    return sum(float(sent(method, payload, name).replace(",", "")) for name in ("up, kbit", "down, kbit"))


def feedback_gains() -> list[float]:
    """How many times smaller feedback makes the error over all rounds."""
    rows = list(rows_of("docs/communication.md", "rounding"))
    return [
        float(without["all rounds"]) / float(with_it["all rounds"])
        for without, with_it in zip(*[iter(rows)] * 2, strict=True)
    ]


def clusters(radio: str, name: str, *, several: bool, uavs: str = "") -> list[float]:
    return [
        float(row[name].replace(",", ""))
        for row in rows_of("docs/scaling.md", "clusters")
        if row["radio"].startswith(radio) and (row["K"] != "1") == several and uavs in ("", row["N"])
    ]


def fewer_received() -> list[float]:
    """How many times fewer messages the leader receives with √N clusters."""
    rows = list(rows_of("docs/scaling.md", "clusters"))
    received = {(row["radio"], int(row["N"]), int(row["K"])): float(row["received by UAV h"]) for row in rows}
    return [received[radio, uavs, 1] / value for (radio, uavs, heads), value in received.items() if heads**2 == uavs]


def flights_of(method: str) -> list[dict[str, Any]]:
    return [row for row in published.read_rows(RESULTS / "free_flights.json")[1] if row["method"] == method]


def more_bits() -> list[float]:
    """Bits of clusters beside those of one leader, % more."""
    rows = list(rows_of("docs/scaling.md", "clusters"))
    bits = {(row["radio"], row["N"], row["K"]): float(row["up, kbit"].replace(",", "")) for row in rows}
    return [
        100.0 * (value / bits[radio, uavs, "1"] - 1.0) for (radio, uavs, heads), value in bits.items() if heads != "1"
    ]


@cache
def first_flight() -> dict[str, Any]:
    return dict(mf.fly("paper", seed=1).summary)


def shown(*formats: str) -> list[str]:
    """Numbers of the summary of the first flight: `phi_A:.3f`, or `payload_bits.uplink:,` of a table in it."""
    found = []
    for each in formats:
        path, _, form = each.partition(":")
        found.append(format(reduce(getitem, path.split("."), first_flight()), form))
    return found


@cache
def records() -> dict[str, dict[str, Any]]:
    found: dict[str, dict[str, Any]] = json.loads(tuning.RECORD.read_text(encoding="utf-8"))
    return found


def chosen(name: str) -> dict[str, Any]:
    record = records()[name]
    return next(each for each in record["candidates"] if each["options"] == record["chosen"] and each["flights"] > 10)


def tuned(names: tuple[str, ...], shown: tuple[str, ...]) -> list[str]:
    """Unsafe flights of the chosen candidates, and their constants."""
    found = [chosen(name) for name in names]
    words = [f"`{key}` {', '.join(format(each['options'][key], 'g') for each in found)}" for key in shown]
    return [", ".join(str(each["unsafe"]) for each in found), ("; " if len(found) > 1 else ", ").join(words)]


def fewest_kbit(row: str, uavs: int, lost: float) -> float:
    """The fewest bits that show the highest target of the published frontier."""
    found = frontier.read(RESULTS / frontier.FILE)
    cell = next(each for each in found.cells_of("streams", uavs) if (each.row, each.outage) == (row, lost))
    reached = cell.reached[-1]
    return math.nan if reached is None else reached.kbit


def claim(number: str) -> dict[str, Any]:
    found: list[dict[str, Any]] = json.loads((RESULTS / "claims.json").read_text(encoding="utf-8"))
    return next(record for record in found if record["id"] == number)


def verdicts(scenario: str) -> list[int]:
    """Number of claims of the paper, then of those with each verdict, in the order of the README."""
    records = json.loads((RESULTS / "claims.json").read_text(encoding="utf-8"))
    found = counted(records, scenario)
    order = (REPRODUCED, BY_CONSTRUCTION, NOT_REFUTED, NOT_REPRODUCED, UNDECIDED, NOT_TESTABLE)
    return [sum(found.values()), *(found[verdict] for verdict in order)]


def free(row: str, mission: str = "swap") -> str:
    count = free_flights(row, [mission])
    return f"{count}" if count else "none"


def arrived(row: str, mission: str) -> str:
    return f"{100 * standing(mission, row).cells['arrived'].mean:.0f}"


@cache
def radio_losses(floats: int) -> float:
    """Messages of so many floats that the default radio loses, %."""
    return 100.0 * link.expected(load(None).radio, np.ones(1), 32 * floats)[0]


def long_model() -> tuple[int, int, str]:
    """Fragments of a model of 10⁵ floats on the default radio, slots of each, and ticks until it is in place."""
    scenario = rounds._scenario("leader", 25, rounds.Long)
    fragments = scenario.hops[0].coding.fragments
    assert fragments is not None
    ticks = scenario.hops[-1].after + scenario.hops[-1].coding.ticks - 1 + scenario.hop_ticks
    return fragments.count, fragments.cut.slots, {4: "four"}[ticks]


def secure_bits(uavs: int) -> float:
    """Bits of a round of secure aggregation beside those of a plain one, with models of 246 floats."""
    keys, shares = 2 * 256 * uavs, uavs * (uavs - 1)
    return 1.0 + (2 * keys + (2 * 656 + 264) * shares) / ((uavs + 1) * 32 * MODEL_FLOATS)


def scientific(value: float) -> str:
    digits, exponent = f"{value:.1e}".split("e")
    return f"{digits}·10{str(int(exponent)).translate(str.maketrans('-0123456789', '⁻⁰¹²³⁴⁵⁶⁷⁸⁹'))}"


def zenoh_share() -> float:
    """Share of bare Zenoh in a tick of many processes, median of their numbers."""
    figures = record(scaling.RECORD)["races"]["scale_processes"]["figures"]
    return 1.0 / float(np.median([one["ratio"] for one in figures if one["ratio"]]))


def installed(group: str) -> int:
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    return len(tomllib.loads(text)["project"]["entry-points"][f"meanflock.{group}"])
