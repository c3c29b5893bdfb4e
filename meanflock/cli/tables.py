"""Tables in a terminal: the means of a study in 80 columns, without numbers that are cut off."""

from collections.abc import Sequence
from typing import Any

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from meanflock.channel.meter import TRAFFIC
from meanflock.results import quantities
from meanflock.results.rounds_table import MEAN, METRIC
from meanflock.studies.each_round import LAST_ROUND
from meanflock.studies.means import METRICS, ROUNDS, Means
from meanflock.studies.rerun import FlightDifference
from meanflock.studies.tradeoff import Tradeoff
from meanflock.swarm.errors import printable

WIDTH = 80  # of a terminal, at least
_LONGEST = 12  # characters of a hash
_WIDE = 1000  # columns: wider than any table
_PREFIXES = ((1e9, "G"), (1e6, "M"), (1e3, "k"), (1.0, ""))
MEANS = (
    "Means over {n} flight{s} each and all UAVs. Travel time: a UAV that never arrived counts with the duration{time}. "
    "Lower is better everywhere but in arrivals."
)
_MARKS = {"best": "*", "undecided": "?"}
VERDICTS = " * is significantly best, ? is undecided (paired by seed, Holm's method)."


def means_table(means: Means, title: str, durations_s: Sequence[float]) -> Table:
    """Table of means in 80 columns, without names that are cut off."""
    rows = list(means.rows())
    n = max(row["n"] for _, row in rows)
    time = f", {durations_s[0]:g} s" if len(set(durations_s)) == 1 else ""
    note = MEANS.format(n=n, s="s" * (n > 1), time=time)
    note += VERDICTS if {*means.verdicts.values()} & {*_MARKS} else ""
    constant = [f"{values}" for place, values in enumerate(next(iter(means.points))) if place not in means.varying]
    shown = _empty(means, ", ".join([title, *constant]), note)
    scale, prefix = _scale(rows)
    for metric in METRICS:
        shown.add_column(_heading(quantities.quantity(metric), prefix), justify="right", no_wrap=True)
    for values, row in rows:
        row["payload_bits"] /= scale
        cells = ["–" if (mean := row[quantities.table_column(metric)]) is None else f"{mean:.4g}" for metric in METRICS]
        cells[0] += f"/{row['uavs']}"  # of the arrivals
        marks = [_MARKS.get(str(row[f"{quantities.table_column(metric)}_verdict"]), "") for metric in METRICS]
        shown.add_row(*_named(means, values), *map("".join, zip(cells, marks, strict=True)))
    if Console(width=10 * WIDTH).measure(shown).maximum > WIDTH:
        shown.padding = 0
    return shown


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
    for head in ("rounds", "void", "n", *(name.removeprefix(begin) for name in last)):
        shown.add_column(head, justify="right", overflow="fold")
    for values, row in rows:
        cells = ["–" if row[name] is None else f"{row[name]:.4g}" for name in (*ROUNDS, f"{begin}n", *last)]
        shown.add_row(*_named(means, values), *cells)
    if Console(width=10 * WIDTH).measure(shown).maximum > WIDTH:
        for column in shown.columns[len(means.varying) :]:
            column.header = _broken(str(column.header))
        shown.padding = 0
    return shown


def tradeoff_table(means: Means, found: Tradeoff) -> Table:
    """Table of two objectives with their intervals, and of the place of each point."""
    note = (
        "dominated: another point is better in one of them, and better or equal in the other. undecided: it may be, by "
        "95 % intervals of the differences, paired by seed."
    )
    shown = _empty(means, f"\nPareto front of {found.x.name} and {found.y.name}", note)
    shown.add_column("n", justify="right", no_wrap=True)
    for objective in (found.x, found.y):
        shown.add_column(f"{objective.label}\n{objective.better} is better", justify="right", no_wrap=True)
    shown.add_column("Pareto", no_wrap=True)
    for values, placed in found.placed.items():
        cells = ["–" if each.n == 0 else each.shown(".4g") for each in (placed.x, placed.y)]
        shown.add_row(*_named(means, values), str(placed.x.n), *cells, placed.place or "unknown")
    return shown


def differences_table(names: Sequence[str], differences: Sequence[FlightDifference]) -> Table:
    """Table of the fields of flights that differ from those of a study."""
    shown = Table(title="Flights that differ", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    shown.show_edge = False
    shown.title_justify = "left"
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
    shown = Table(title=title, caption=note, box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    shown.show_edge = False
    shown.title_justify = "left"
    shown.caption_justify = "left"
    for name in (means.names[place] for place in means.varying):
        shown.add_column(_broken(name), overflow="fold", no_wrap=name == "method")
    return shown


def _scale(rows: Sequence[tuple[tuple[Any, ...], dict[str, Any]]]) -> tuple[float, str]:
    """The prefix of the unit of all payloads, and its size."""
    most = max(row["payload_bits"] for _, row in rows)
    return next(((scale, prefix) for scale, prefix in _PREFIXES if most >= scale), (1.0, ""))


def _heading(quantity: quantities.Quantity, prefix: str) -> str:
    """The heading of a column with its unit; bits have a prefix."""
    unit = f"{prefix}bit" if quantity is quantities.PAYLOAD else quantity.unit or "1"
    return f"{quantity.heading}\n({unit})"


def _broken(name: str) -> str:
    """A dotted key that may be broken into lines."""
    return name.replace(".", ".\n").replace("_", "_\n").replace(" (", "\n(")


def console_for(table: Table) -> Console:
    """Console on standard output, at least as wide as the table; a narrower terminal wraps lines."""
    console, wide = Console(), Console(width=_WIDE)
    wanted = wide.measure(table).maximum
    for column in table.columns:
        if not column.no_wrap:
            cells = [wide.measure(cell) for cell in (column.header, *column.cells)]
            wanted -= max(cell.maximum for cell in cells) - max(cell.minimum for cell in cells)
    return console if console.width >= wanted else Console(width=wanted)
