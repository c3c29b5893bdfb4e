"""Tables of stored runs in a terminal, and the same as JSON records."""

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from meanflock.cli.tables import empty, print_table
from meanflock.launch.progress import groups_table, summary_table
from meanflock.results.flown import flown_keys
from meanflock.results.in_words import UNKNOWN, bits, flown, named, number, outcome, setting
from meanflock.results.rounds_table import MEAN, METRIC, NO_ROUNDS, OF_UAVS, column_heading, rounds_table, stored_rounds
from meanflock.results.run_difference import Difference
from meanflock.results.run_folder import EVENTS
from meanflock.results.scenario_keys import changed_keys
from meanflock.results.stored_run import StoredFolder
from meanflock.swarm.errors import printable

_ABOUT = {  # of the files of a run folder
    "scenario.toml": "the scenario: `meanflock run` flies it again",
    "summary.json": "the results",
    "timeseries.parquet": "a row for each tick: `meanflock plot`",
    "events.jsonl": "a line for each event",
    "rounds.parquet": "a row for each round: `meanflock show --rounds`",
    "recording.rrd": "the recording: `meanflock view`, `picture`",
    "checkpoint.msgpack": "from here `meanflock resume` continues",
    ".telemetry": "rows of the time series so far",
    "plugins/": "copies of the plug-in files that flew",
    "plots/": "plots of `meanflock plot`",
}
_IN_THE_NAME = ("when", "method", "seed")  # columns that the name of a run repeats
_LEFT = ("run", "when", "method", "mission")  # columns of text
_LONGEST_PATH = 4096  # characters
_WIDE = 1000  # columns: wider than any table
_OF_GROUP = "groups."  # begins the figures of a group
_MOST_TRAFFIC = "radio.traffic."  # figures by kind of traffic are in the JSON record only


def list_table(runs: Sequence[StoredFolder]) -> Table:
    """Table of runs. In a narrow terminal it leaves out columns that the names of all runs repeat."""
    rows = [_cells(run) for run in runs]
    names = [re.match(r"\d{8}-\d{6}-(.+)-s\d", run.folder.name) for run in runs]
    whole = _table(rows, ())
    if None in names or Console(width=_WIDE).measure(whole).maximum <= Console().width:
        return whole
    has_method = all(name is not None and name[1] == row["method"] for name, row in zip(names, rows, strict=True))
    return _table(rows, _IN_THE_NAME if has_method else [name for name in _IN_THE_NAME if name != "method"])


def _table(rows: Sequence[dict[str, str]], left_out: Sequence[str]) -> Table:
    shown = empty()
    names = [name for name in rows[0] if name not in left_out]
    for name in names:
        justify: Literal["left", "right"] = "left" if name in _LEFT else "right"
        shown.add_column(name, no_wrap=name != "mission", overflow="fold", justify=justify)
    for row in rows:
        shown.add_row(*(escape(row[name]) for name in names))
    return shown


def _cells(run: StoredFolder) -> dict[str, str]:
    """The cells of a run, by column."""
    finished = run.status == "finished"
    return {
        "run": run.run_id,
        "when": f"{run.when.astimezone():%Y-%m-%d %H:%M}",
        "method": named(run, "method"),
        "mission": str(run.mission or UNKNOWN),
        "N": named(run, "uavs"),
        "seed": named(run, "seed"),
        "arrived": number(run.figure("arrived")) if finished else run.status,
        "coll.": number(run.figure("collisions")) if run.status != "damaged" else "",
        "sent": bits(run.figure("payload_bits.total")) if run.status != "damaged" else "",
    }


def record(run: StoredFolder) -> dict[str, Any]:
    """A run as a JSON object of a list; an unknown value is null."""
    mission = run.mission
    return {
        "run_id": run.folder.name,
        "folder": str(run.folder),
        "when": run.when.astimezone().isoformat(timespec="seconds"),
        "status": run.status,
        "fault": run.fault or None,
        "failure": run.failure or None,
        "method": run.named("method"),
        "mission": mission and mission.name,
        "changed": mission and mission.changed,
        "uavs": run.named("uavs"),
        "seed": run.named("seed"),
        "arrived": run.figure("arrived"),
        "collisions": run.figure("collisions"),
        "payload_bits": run.figure("payload_bits.total"),
    }


def full_record(run: StoredFolder) -> dict[str, Any]:
    """A run as a JSON object: the record of a list, changed keys, summary and sizes of files."""
    keys = {key: {"value": value, "default": default} for key, (value, default) in changed_keys(run.keys).items()}
    return {**record(run), "keys": keys, "summary": run.summary or None, "files": _files(run)}


def print_run(run: StoredFolder) -> None:
    """Print a run: sentences, changed keys, summary and files."""
    console = Console()
    console.print(f"[bold]{_path(run)}[/]", soft_wrap=True, highlight=False)
    console.print(f"{flown(run)}. {outcome(run)}", markup=False, highlight=False)
    keys = _headed("key", "value", "default")
    for key, (value, default) in changed_keys(run.keys).items():
        keys.add_row(escape(key), escape(setting(value)), escape(setting(default)))
    _print_titled(f"Keys that differ from the paper's scenario: {keys.row_count or 'none'}", keys)
    if run.summary:
        results = summary_table(run.summary, run.keys.get("until"))
        results.title = None
        results.box = None
        results.pad_edge = False
        _print_titled("Results", results)
    if groups := run.figure("groups"):
        _print_titled("Groups", groups_table(groups))
    files = _headed("file", "size", "")
    files.columns[1].justify = "right"
    for name, size in _files(run).items():
        files.add_row(escape(printable(name)), bits(size, "B"), _ABOUT.get(name, ""))
    _print_titled("Files", files)


_COUNTS = (
    "averaging",
    "lost",
    "silent",
    "absent",
    "late",
    "refused",
    "isolated",
    "retries",
)  # shown where any is above 0


def print_rounds(folder: Path, as_json: bool) -> None:
    """Print the rounds of a run: a table, or all columns as JSON.

    Raises:
        BadInput: no run there, or its events are damaged.
    """
    table = rounds_table(stored_rounds(folder / EVENTS), flown_keys(folder).dt)
    if as_json:
        print(json.dumps(table.to_pylist(), indent=1))
        return
    if not table.num_rows:
        print(f"{folder}: the run has {NO_ROUNDS}")
        return
    means = [name for name in table.column_names if name.startswith((MEAN, METRIC))]
    counts = [name for name in _COUNTS if any(table[name].to_pylist())]
    is_even = set(table["outcome"].to_pylist()) == {"averaged"}
    rows = [
        {
            "round": str(row["round"]),
            "time\n(s)": f"{row['sim_time_s']:g}",
            **({} if is_even else {"outcome": row["outcome"]}),
            **{name: str(row[name]) for name in ("sent", "received", *counts)},
            "sent\nso far": bits(row["bits"], "bit"),
            "airtime\n(s)": f"{row['airtime_s']:.3g}",
            **{column_heading(name): "–" if row[name] is None else f"{row[name]:.3g}" for name in means},
        }
        for row in table.to_pylist()
    ]
    shown = empty()
    for name in rows[0]:
        shown.add_column(name, justify="right", no_wrap=True)
    for row in rows:
        shown.add_row(*row.values())
    if any(name.startswith(MEAN) for name in means):
        shown.caption = OF_UAVS
    print_table(shown)


def _files(run: StoredFolder) -> dict[str, int]:
    """Size in bytes of each file of a run; folders end in a slash."""
    found = {}
    for path in sorted(run.folder.iterdir()):
        inner = [file for file in path.rglob("*") if file.is_file()] if path.is_dir() else [path]
        found[f"{path.name}/" if path.is_dir() else path.name] = sum(file.stat().st_size for file in inner)
    return found


def print_difference(found: Difference) -> None:
    """Print which keys and figures differ."""
    console = Console()
    for letter, run in (("A", found.first), ("B", found.second)):
        console.print(f"[bold]{letter}[/]  {_path(run)}", soft_wrap=True, highlight=False)
        console.print(f"   {flown(run)}", markup=False, highlight=False)
    keys = _headed("key", "A", "B")
    for key, values in found.keys.items():
        keys.add_row(escape(key), *(escape(setting(value)) for value in values))
    _print_titled(f"Keys that differ: {len(found.keys) or 'none'}", keys)
    shown = [figure for figure in found.figures if not figure.key.startswith(_MOST_TRAFFIC)]
    tables: dict[str, Table] = {"": _figures()}
    for figure in shown:
        group, key = "", figure.key
        if key.startswith(_OF_GROUP):
            group, key = key.removeprefix(_OF_GROUP).split(".", 1)
        cells = map(number, (figure.first, figure.second, figure.change))
        tables.setdefault(group, _figures()).add_row(escape(printable(key)), figure.unit, *cells)
    number_of = len(found.figures) or "none"
    for group, table in tables.items():
        _print_titled(
            f"Group {escape(group)}" if group else f"Figures that differ: {number_of} of {found.compared}", table
        )
    if hidden := len(found.figures) - len(shown):
        console.print(f"{hidden} more, by kind of traffic: --json", highlight=False)
    same = "Both flights are bit-identical." if found.same_flight else "The flights are different."
    console.print(f"\n{same}", highlight=False)


def _figures() -> Table:
    """A table without rows of figures that differ."""
    table = _headed("figure", "unit", "A", "B", "B − A")
    for column in table.columns[2:]:
        column.justify, column.no_wrap = "right", True
    return table


def _path(run: StoredFolder) -> str:
    """The folder of a run, as text that is not taken for markup."""
    return escape(printable(str(run.folder), _LONGEST_PATH))


def _headed(*headings: str) -> Table:
    table = empty()
    for heading in headings:
        table.add_column(heading, overflow="fold")
    return table


def _print_titled(title: str, table: Table) -> None:
    """Print a table under a title, after an empty line; the title only if it has no rows."""
    Console().print(f"\n[bold]{title}[/]", highlight=False)
    if table.row_count:
        print_table(table)
