"""The tables of docs/round-cost.md."""

import math
from collections.abc import Callable, Sequence
from typing import Any

from meanflock.results import statistics
from meanflock.studies import published
from meanflock.studies.markdown import table, with_parts
from research.round_cost.flights import ACCESS, CONTENTION, FIRST_SEED, OWN, SHARED, Cell

PAGE = published.DOCS / "round-cost.md"
RESULTS = published.DOCS / "results" / "round_cost.json"
PLAIN = (OWN, SHARED, CONTENTION)
Row = dict[str, Any]
Rows = dict[Cell, list[Row]]


def page(text: str, code: str, rows: Sequence[Row]) -> str:
    """The page `text` with the tables of these flights."""
    found = by_cell(rows)
    few, many = min(map(len, found.values())), max(map(len, found.values()))
    flown = (
        f"{len(rows):,} flights with seeds from {FIRST_SEED} on: {few} of each cell, and {many} on the two radios that "
        "lose slots, whose flights differ more."
    )
    parts = {
        "flights": [flown, "", published.flown_by(code)],
        "ranking": ranking(found),
        "rounds": _by_access(found, _round),
        "accuracy": _by_access(found, _accuracy),
        "costs": _costs(found),
        "tracking": _tracking(found),
    }
    return with_parts(text, parts)


def by_cell(rows: Sequence[Row]) -> Rows:
    """The flights of each cell, by ascending seed."""
    found: Rows = {}
    for row in rows:
        found.setdefault(Cell(*(row[name] for name in Cell._fields)), []).append(row)
    return found


def gain(found: Rows, radio: str, access: str) -> statistics.Estimate:
    """Accuracy with neighbours less that under a leader, in percentage points, paired by seed."""
    neighbours, leader = (
        [100.0 * row["accuracy"] for row in found[Cell("classifier", radio, way, access)]]
        for way in ("neighbours", "leader")
    )
    return statistics.difference(neighbours, leader)


def tracking_saved(found: Rows, radio: str, access: str) -> statistics.Estimate:
    """Logarithm of the leader's tracking cost less that of neighbours, paired by seed."""
    return statistics.difference(
        *(_logarithms(found[Cell("fed-lspi", radio, way, access)]) for way in ("leader", "neighbours"))
    )


def verdict(advantage: statistics.Estimate) -> str:
    """The better way, neighbours or leader; undecided if the 95 % interval of their difference contains 0."""
    if advantage.low <= 0.0 <= advantage.high:
        return "undecided"
    return "neighbours" if advantage.value > 0.0 else "leader"


def ranking(found: Rows) -> list[str]:
    """A row for each radio and access: neighbours beside a leader."""
    rows = []
    for radio in (radio for radio, way in _ways(found) if way == "leader"):
        for access in PLAIN:
            leader, neighbours = (found[Cell("classifier", radio, way, access)] for way in ("leader", "neighbours"))
            points, saved = gain(found, radio, access), tracking_saved(found, radio, access)
            ratio = [math.exp(-end) for end in (saved.value, saved.high, saved.low)]
            rows.append(
                (
                    radio,
                    access,
                    f"{_mean(leader, 'round_s'):.1f}",
                    f"{_mean(neighbours, 'round_s'):.1f}",
                    _accuracy(leader),
                    _accuracy(neighbours),
                    f"{points.value:+.2f} [{points.low:+.2f}, {points.high:+.2f}]",
                    verdict(points),
                    f"× {ratio[0]:.2f} [{ratio[1]:.2f}, {ratio[2]:.2f}]",
                    verdict(saved),
                )
            )
    head = ("radio", "access", "round of a leader, s", "of neighbours, s", "leader, %", "neighbours, %")
    return table((*head, "difference", "better", "tracking", "better"), rows)


def _by_access(found: Rows, shown: Callable[[Sequence[Row]], str]) -> list[str]:
    """A row for each radio and way, a column for each access."""
    rows = [
        (radio, way, *(shown(found.get(Cell("classifier", radio, way, access), [])) for access in ACCESS))
        for radio, way in _ways(found)
    ]
    return table(("radio", "way", *ACCESS), rows)


def _costs(found: Rows) -> list[str]:
    """A row for each radio and way: what a round of the classifier costs, by access."""
    rows = []
    for radio, way in _ways(found):
        cells = [found[Cell("classifier", radio, way, access)] for access in PLAIN]
        rows.append(
            (
                radio,
                way,
                f"{_mean(cells[1], 'kbit') / 1e3:.2f}",
                *(
                    " / ".join(f"{scale * _mean(cell, name):.3g}" for cell in cells)
                    for name, scale in (
                        ("airtime_s", 1.0),
                        ("band_time_MHz_s", 1.0),
                        ("radio_J", 1.0),
                        ("lost_share", 100.0),
                    )
                ),
            )
        )
    return table(("radio", "way", "Mbit", "airtime, s", "MHz·s", "radios, J", "lost, %"), rows)


def _tracking(found: Rows) -> list[str]:
    """A row for each radio and way of `fed-lspi`."""
    rows = []
    for radio, way in _ways(found):
        cells = [found[Cell("fed-lspi", radio, way, access)] for access in PLAIN]
        every = [row for cell in cells for row in cell]
        rows.append(
            (
                radio,
                way,
                " / ".join(f"{_mean(cell, 'round_s'):.1f}" for cell in cells),
                *map(_cost, cells),
                " / ".join(f"{_mean(cell, 'band_time_MHz_s'):.3g}" for cell in cells),
                " / ".join(f"{100 * _mean(cell, 'lost_share'):.0f}" for cell in cells),
                f"{sum(row['arrived'] for row in every)} of {sum(row['uavs'] for row in every)}",
            )
        )
    head = ("radio", "way", "round, s", *(f"tracking, {access}" for access in PLAIN), "MHz·s", "lost, %", "arrived")
    return table(head, rows)


def _ways(found: Rows) -> list[tuple[str, str]]:
    """Radio and way of the rows of a table."""
    return list(dict.fromkeys((cell.radio, cell.way) for cell in found))


def _round(rows: Sequence[Row]) -> str:
    """Seconds of a round, and rounds in the flight."""
    return f"{_mean(rows, 'round_s'):.1f} s, {_mean(rows, 'rounds'):.0f}" if rows else ""


def _accuracy(rows: Sequence[Row]) -> str:
    return statistics.mean([100.0 * row["accuracy"] for row in rows]).shown(".1f") if rows else ""


def _cost(rows: Sequence[Row]) -> str:
    """Geometric mean of tracking costs with its 95 % interval."""
    found = statistics.mean(_logarithms(rows))
    return f"{math.exp(found.value):.0f} [{math.exp(found.low):.0f}, {math.exp(found.high):.0f}]"


def _logarithms(rows: Sequence[Row]) -> list[float]:
    return [math.log(row["tracking"]) for row in rows]


def _mean(rows: Sequence[Row], name: str) -> float:
    return statistics.mean([row[name] for row in rows]).value
