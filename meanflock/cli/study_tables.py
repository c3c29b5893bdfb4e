"""The tables of a study in a terminal."""

import textwrap
from collections.abc import Sequence
from statistics import fmean
from typing import Any

from rich.markup import escape
from rich.table import Table

from meanflock.channel.meter import TRAFFIC
from meanflock.cli.tables import empty
from meanflock.results import quantities
from meanflock.results.rounds_table import MEAN, METRIC, column_heading
from meanflock.studies.each_round import LAST_ROUND
from meanflock.studies.means import METRICS, ROUNDS, Means
from meanflock.studies.rerun import FlightDifference
from meanflock.studies.tradeoff import Tradeoff
from meanflock.studies.verdicts import rivalry
from meanflock.swarm.errors import printable

_LONGEST = 12  # characters of a hash
_OBJECTIVE = 24  # characters of a line of the heading of an objective
_PREFIXES = ((1e9, "G"), (1e6, "M"), (1e3, "k"), (1.0, ""))
MEANS = (
    "Means over {n} flight{s} each and all UAVs. Travel time: a UAV that never arrived counts with the duration{time}. "
    "Lower is better everywhere but in arrivals."
)
_MARKS = {"best": "*", "undecided": "?"}
VERDICTS = " * is significantly better than every {rival}, ? is undecided (paired by seed, Holm's method)."
_EQUAL = " No number differs between the rows."
_ONE_FLIGHT = " Which row is significantly best is unknown: each has one flight."


def means_table(means: Means, title: str, durations_s: Sequence[float]) -> Table:
    """Table of means in 80 columns, without names that are cut off."""
    rows = list(means.rows())
    n = max(row["n"] for _, row in rows)
    time = f", {durations_s[0]:g} s" if len(set(durations_s)) == 1 else ""
    note = MEANS.format(n=n, s="s" * (n > 1), time=time)
    note += _verdicts(means, n)
    constant = [f"{values}" for place, values in enumerate(next(iter(means.points))) if place not in means.varying]
    shown = _empty(means, ", ".join([title, *constant]), note)
    scale, prefix = _scale(rows)
    for metric in METRICS:
        shown.add_column(_heading(quantities.quantity(metric), prefix), justify="right", no_wrap=True)
    for values, row in rows:
        row["payload_bits"] /= scale
        cells = [_number(row[quantities.table_column(metric)]) for metric in METRICS]
        cells[0] += f"/{row['uavs']}"  # of the arrivals
        marks = [_MARKS.get(str(row[f"{quantities.table_column(metric)}_verdict"]), "") for metric in METRICS]
        shown.add_row(*_named(means, values), *map("".join, zip(cells, marks, strict=True)))
    return shown


def _verdicts(means: Means, n: int) -> str:
    """A sentence that explains the marks `*` and `?`, or says why no row has one; empty if neither is needed.

    `n`: largest number of flights of a row.
    """
    found = {*means.verdicts.values()}
    if found & {*_MARKS}:
        differing = rivalry(means.names, means.points)
        is_one_family = not differing or {means.names[place] for place in means.varying} <= {*differing}
        keys = dict.fromkeys(name.rpartition(".")[2] for name in differing)
        rival = f"row that differs in {' or '.join(keys)} only"
        return VERDICTS.format(rival="other row" if is_one_family else rival)
    if n == 1 and len(means.points) > 1:
        return _ONE_FLIGHT
    return _EQUAL if found == {"equal"} else ""


def counts_table(means: Means) -> Table | None:
    """Table of the mean counts that any flight has, as of lost UAVs and hits of obstacles; None if all are zero."""
    points = means.points
    counted = [
        field for field in quantities.COUNTS if any(each.get(field) for flights in points.values() for each in flights)
    ]
    shown = _empty(means, "\nfurther counts: means over the flights", "")
    for field in counted:
        shown.add_column(_heading(quantities.COUNTS[field]), justify="right", no_wrap=True)
    for values, flights in points.items():
        numbers = ([each[field] for each in flights if each[field] is not None] for field in counted)
        shown.add_row(*_named(means, values), *map(_mean, numbers))
    return shown if counted else None


def until_table(means: Means) -> Table | None:
    """Table of what it cost to reach the bound of `until`; None if no flight has a bound."""
    if all(each.get("until") is None for flights in means.points.values() for each in flights):
        return None
    scale, prefix = _scale(list(means.rows()))
    shown = _empty(means, "\nbound of --until: means over the flights that reached it", "")
    for head in (
        "flights",
        "round",
        "time\n(s)",
        f"payload\n({prefix}bit)",
        "airtime\n(s)",
        "energy of\nall UAVs\n(J)",
    ):
        shown.add_column(head, justify="right", no_wrap=True)
    for values, flights in means.points.items():
        bounds = [each["until"] for each in flights if each["until"] is not None]
        reached = [each for each in bounds if each["reached"]]
        costs = {"round": 1.0, "time_s": 1.0, "bits": scale, "airtime_s": 1.0, "energy_J": 1.0}  # units, by field
        numbers = ([each[field] / unit for each in reached] for field, unit in costs.items())
        shown.add_row(*_named(means, values), f"{len(reached)}/{len(bounds)}", *map(_mean, numbers))
    return shown


def _mean(values: Sequence[float]) -> str:
    return _number(fmean(values) if values else None)


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.4g}"


def payload_table(means: Means) -> Table:
    """Table of the mean payload by kind of traffic, of those that any flight has."""
    rows = list(means.rows())
    scale, prefix = _scale(rows)
    shown = _empty(means, "\npayload by kind of traffic", "")
    kinds = [kind for kind in TRAFFIC.values() if any(row[f"{kind}_bits"] for _, row in rows)]
    for kind in kinds:
        shown.add_column(f"{kind}\n({prefix}bit)", justify="right", no_wrap=True)
    for values, row in rows:
        shown.add_row(*_named(means, values), *(f"{row[f'{kind}_bits'] / scale:.4g}" for kind in kinds))
    return shown


def rounds_table(means: Means) -> Table | None:
    """Table of the rounds, and of the means of the last averaged one; None if no flight averaged a round."""
    rows = list(means.rows())
    begin = f"{LAST_ROUND}_"
    last = [name for name in rows[0][1] if name.startswith((f"{begin}{MEAN}", f"{begin}{METRIC}"))]
    last = [name for name in last if not name.endswith(("_low", "_high"))]
    if f"{begin}n" not in rows[0][1]:
        return None
    shown = _empty(means, "\nrounds, and means of n flights at the end of the last averaged round", "")
    for head in ("rounds", "void", "n", *(column_heading(name.removeprefix(begin)) for name in last)):
        shown.add_column(head, justify="right", overflow="fold")
    for values, row in rows:
        cells = [_number(row[name]) for name in (*ROUNDS, f"{begin}n", *last)]
        shown.add_row(*_named(means, values), *cells)
    return shown


def groups_table(means: Means) -> Table | None:
    """Table of the means of each group of UAVs; None if no flight has groups."""
    scale, prefix = _scale(list(means.rows()))
    note = "Airtime: how long the UAVs of a group sent. A collision of UAVs of two groups counts in both."
    shown = _empty(means, "\nmeans of each group of UAVs", note)
    shown.add_column("group", overflow="fold")
    measured = (quantities.ARRIVED, quantities.ENERGY_TO_ARRIVAL, quantities.PAYLOAD, quantities.COLLISIONS)
    for head in (*(_heading(one, prefix) for one in measured), "airtime\n(s)"):
        shown.add_column(head, justify="right", no_wrap=True)
    for values, summaries in means.points.items():
        for name, group in (summaries[0]["groups"] or {}).items():
            flown = [summary["groups"][name] for summary in summaries]
            numbers = (
                [each["energy_mean_J"] for each in flown],
                [each["payload_bits"]["total"] / scale for each in flown],
                [each["collisions"] for each in flown],
                [each["airtime_s"] for each in flown],
            )
            arrived = f"{fmean(each['arrived'] for each in flown):.4g}/{group['uavs']}"
            shown.add_row(*_named(means, values), name, arrived, *(f"{fmean(each):.4g}" for each in numbers))
    return shown if shown.row_count else None


def tradeoff_table(means: Means, found: Tradeoff) -> Table:
    """Table of two objectives with their intervals, and of the place of each point."""
    note = (
        "dominated: another point is better in one of them, and better or equal in the other. undecided: it may be, by "
        "95 % intervals of the differences, paired by seed."
    )
    if not all(placed.place for placed in found.placed.values()):
        note += " unknown: a flight of the point lacks one of the numbers."
    shown = _empty(means, f"\nPareto front of {found.x.name} and {found.y.name}", note)
    shown.add_column("n", justify="right", no_wrap=True)
    for objective in (found.x, found.y):
        heading = textwrap.fill(objective.label, _OBJECTIVE)
        shown.add_column(f"{heading}\n{objective.better} is better", justify="right", no_wrap=True)
    shown.add_column("Pareto", no_wrap=True)
    for values, placed in found.placed.items():
        cells = ["–" if each.n == 0 else each.shown(".4g") for each in (placed.x, placed.y)]
        shown.add_row(*_named(means, values), str(placed.x.n), *cells, placed.place or "unknown")
    return shown


def differences_table(names: Sequence[str], differences: Sequence[FlightDifference]) -> Table:
    """Table of the fields of flights that differ from those of a study."""
    shown = empty("Flights that differ")
    for head in (*map(_broken, names), "seed", "field", "expected", "found"):
        shown.add_column(head, overflow="fold")
    for each in differences:
        values = [*each.point, each.seed, each.field, *(_short(value) for value in (each.expected, each.found))]
        shown.add_row(*map(escape, map(printable, map(str, values))))
    return shown


def _short(value: Any) -> str:
    """A number with all digits, or the beginning of a hash; a dash if it is unknown."""
    return "–" if value is None else value[:_LONGEST] if isinstance(value, str) else repr(value)


def _named(means: Means, point: Sequence[Any]) -> list[str]:
    """The cells of the values of a point."""
    return [str(point[place]) for place in means.varying]


def _empty(means: Means, title: str, note: str) -> Table:
    """A table whose first columns are the varied values, without those that are the same everywhere."""
    shown = empty(title, note)
    for name in (means.names[place] for place in means.varying):
        shown.add_column(_broken(name), overflow="fold", no_wrap=name == "method")
    return shown


def _scale(rows: Sequence[tuple[tuple[Any, ...], dict[str, Any]]]) -> tuple[float, str]:
    """The prefix of the unit of all payloads, and its size."""
    most = max(row["payload_bits"] for _, row in rows)
    return next(((scale, prefix) for scale, prefix in _PREFIXES if most >= scale), (1.0, ""))


def _heading(quantity: quantities.Quantity, prefix: str = "") -> str:
    """The heading of a column with its unit; bits have a prefix."""
    unit = f"{prefix}bit" if quantity is quantities.PAYLOAD else quantity.unit or "1"
    return f"{quantity.heading}\n({unit})"


def _broken(name: str) -> str:
    """A dotted key with its unit, in lines."""
    return name.replace(".", ".\n").replace(" (", "\n(")
