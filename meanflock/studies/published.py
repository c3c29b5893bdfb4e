"""Shared code of the studies behind pages of docs/: options, flights, and files of pages and results."""

import argparse
import inspect
import json
from argparse import ArgumentParser
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from meanflock.studies.job_file import version
from meanflock.studies.runner import terminable
from meanflock.studies.store import Store
from meanflock.studies.study import Fly, Summaries, fly_all
from meanflock.swarm.scenario import Scenario

DOCS = Path(__file__).resolve().parents[2] / "docs"


def options(about: str | None, seeds: int | None = None, page: bool = False) -> ArgumentParser:
    """Parser of the options `--jobs` and, if wanted, `--seeds` and `--page`."""
    parser = ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=-1, help="processes; -1 for one a core")
    if seeds is not None:
        parser.add_argument("--seeds", type=int, default=seeds, help=f"flights of each case (default {seeds})")
    if page:
        parser.add_argument("--page", action="store_true", help="write the page from the results that are there")
    return parser


def flown(
    study: str,
    points: Mapping[Any, Sequence[Scenario]],
    jobs: int,
    fly: Fly | None = None,
    out: Path | None = None,
) -> dict[Any, Summaries]:
    """Fly with `fly_all`, with progress on stderr. Finished flights are stored in `out`, by default out/`study`.

    Raises:
        RunFailed: interrupted, disk full or a process died; the same command flies the rest.
    """
    out = Path("out") / study if out is None else out
    named = study if fly is None else f"{study} {version(Path(inspect.getfile(fly)))}"
    columns = TextColumn(study), BarColumn(bar_width=24), MofNCompleteColumn(), TimeRemainingColumn(compact=True)
    with terminable(out), Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(study, total=None)
        return fly_all(
            points, jobs, lambda done, total: bar.update(task, completed=done, total=total), Store(out), named, fly
        )


def write_rows(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Writes results as JSON: a line with the version of this code, and a line a row."""
    path.write_text("[\n" + ",\n".join(map(json.dumps, [{"code": version()}, *rows])) + "\n]\n", encoding="utf-8")


def read_rows(path: Path) -> tuple[str, list[dict[str, Any]]]:
    """The version of the code, and the results that `write_rows` wrote."""
    head, *rows = json.loads(path.read_text(encoding="utf-8"))
    return head["code"], rows


def write_page(path: Path, page: Callable[[str, str, list[dict[str, Any]]], str], results: Path) -> None:
    """Writes what `page` makes of the page as it is, the version of the code and the results; prints its path."""
    path.write_text(page(path.read_text(encoding="utf-8"), *read_rows(results)), encoding="utf-8")
    print(path)


def flown_by(code: str = "") -> str:
    """The sentence on the version of the code that flew; of this code by default."""
    return f"The flights are of code {code or version()}."
