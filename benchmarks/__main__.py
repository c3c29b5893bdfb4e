"""`python -m benchmarks`: runs the races, writes `docs/performance.md` and `benchmarks/latest.json`."""

import argparse
import importlib
import signal
import sys
import time
from datetime import date
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from benchmarks import store
from benchmarks.figure import Effort, Outcome, Say
from benchmarks.machine import BUSY_LOAD, ROOT, machine, versions
from benchmarks.page import number, page, verdict

PAGE = ROOT / "docs" / "performance.md"
RACES = (
    "networked",
    "in_process",
    "link_budget",
    "avoidance",
    "groups",
    "scale",
    "agent_process",
    "wire",
    "recorder",
    "federated",
    "rounds",
    "monte_carlo",
    "tls",
    "peers",
    "classifier",
    "profile",
)
ON_DEMAND = ("scale_processes", "torch_agents")  # minutes, gigabytes, another environment: only where named
ALL = (*RACES, *ON_DEMAND)
EXIT_INTERRUPTED = 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks",
        description="Measures meanflock and its floors in turns. A full run writes docs/performance.md and "
        "benchmarks/latest.json; --quick and --only print, and write only files of --json or --page.",
        epilog=f"races: {', '.join(RACES)}; only where named: {', '.join(ON_DEMAND)}",
    )
    parser.add_argument("--quick", action="store_true", help="few samples, under a minute")
    parser.add_argument("--only", nargs="+", metavar="NAME", choices=ALL, default=RACES, help="these races")
    parser.add_argument("--json", type=Path, help="write the record here; races not run now are kept from it")
    parser.add_argument("--page", type=Path, help="write the page here")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """The exit code: 0, or 1 when interrupted. A race that fails is part of the result."""
    given = _parser().parse_args(arguments)
    effort = Effort.QUICK if given.quick else Effort.FULL
    whole = not given.quick and tuple(given.only) == RACES
    console = Console(stderr=True)
    for wish in (signal.SIGINT, signal.SIGTERM):  # a shell may have had the first ignored
        signal.signal(wish, signal.default_int_handler)
    started = time.perf_counter()
    record: dict[str, Any] = {
        "schema": store.SCHEMA,
        "date": date.today().isoformat(),
        "seconds": 0.0,
        "machine": machine(),
        "versions": versions(),
        "races": {},
    }
    if record["machine"]["load_before"] > BUSY_LOAD:
        console.print(
            f"[yellow]the machine is busy (load {record['machine']['load_before']}): times will be too long[/]"
        )
    try:
        _races(record, [name for name in ALL if name in given.only], effort, console)
    except KeyboardInterrupt:
        console.print("interrupted; nothing was written")
        return EXIT_INTERRUPTED
    record["seconds"] = round(time.perf_counter() - started, 1)
    measured = {**record, "races": dict(record["races"])}
    json_path = given.json or (store.LATEST if whole else None)
    page_path = given.page or (PAGE if whole else None)
    if given.json and not whole and (earlier := store.read(given.json)):
        races = earlier["races"] | record["races"]
        record["races"] = {name: races[name] for name in ALL if name in races}
    if json_path:
        store.write(json_path, record)
    if page_path:
        page_path.parent.mkdir(parents=True, exist_ok=True)
        page_path.write_text(page(record, PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    _show(measured, console)
    before = store.baseline()
    worse = store.worse(measured, before) if before else []
    for sentence in worse:
        console.print(f"[yellow]worse than committed:[/] {escape(sentence)}", soft_wrap=True)
    if before and not worse:
        console.print("no ratio is worse than committed", highlight=False)
    for path in filter(None, (json_path, page_path)):
        console.print(f"wrote {path}", highlight=False, soft_wrap=True)
    return 0


def _races(record: dict[str, Any], names: list[str], effort: Effort, console: Console) -> None:
    columns = (TextColumn("{task.description}"), BarColumn(bar_width=20), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=len(names))
        for name in names:

            def say(text: str, name: str = name) -> None:
                bar.update(task, description=f"[bold]{name}[/] {escape(text)}")

            say("")
            record["races"][name] = _race(name, effort, say)
            error, seconds = record["races"][name]["error"], record["races"][name]["seconds"]
            bar.console.print(f"{name}: {escape(error) if error else 'done'}, {seconds} s", highlight=False)
            bar.advance(task)


def _race(name: str, effort: Effort, say: Say) -> dict[str, Any]:
    started = time.perf_counter()
    title, about = name, ""
    found: Outcome | str
    try:
        module = importlib.import_module(f"benchmarks.{name}")
        title, about = module.TITLE, module.ABOUT
        found = module.run(effort, say)
    except Exception as error:  # the others still run, and the page says why this one did not
        found = f"{type(error).__name__}: {error}"
    return store.race_record(title, about, found, effort.value, time.perf_counter() - started)


def _show(record: dict[str, Any], console: Console) -> None:
    for name, race in record["races"].items():
        table = Table("", "unit", "median", "min", "max", "ratio", "target", title=f"{name}: {race['title']}")
        for figure in race["figures"]:
            ratio = "" if figure["ratio"] is None else f"{figure['ratio']:.2f}"
            numbers = [number(figure[key]) for key in ("median", "min", "max")]
            table.add_row(escape(figure["name"]), figure["unit"], *numbers, ratio, verdict(figure))
        if race["figures"]:
            console.print(table)
        for note in race["notes"]:
            console.print(escape(note))


if __name__ == "__main__":
    sys.exit(main())
