"""Verbs that fly many times: compare, sweep, plot, paper."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from groundstation.cli import cli, scenario_arguments
from swarm import scenario
from swarm.errors import BadInput

_seeds = click.option(
    "--seeds", type=click.IntRange(1), default=8, show_default=True, metavar="K", help="Runs of each."
)
_jobs = click.option("--jobs", type=int, default=-1, metavar="J", help="Processes; -1 for one a core.  [default: -1]")
_quiet = click.option("--quiet", is_flag=True, help="No progress bar.")


def _out(default: str) -> Callable[[Any], Any]:
    return click.option(
        "--out", type=click.Path(path_type=Path), default=Path(default), show_default=True, metavar="DIR"
    )


@contextmanager
def _progress(what: str, quiet: bool) -> Iterator[Callable[[int, int], None]]:
    bar = Progress(
        TextColumn(f"[bold]{what}"),
        BarColumn(bar_width=24),
        MofNCompleteColumn(),
        TextColumn("runs"),
        TimeRemainingColumn(compact=True),
        console=Console(stderr=True),
        disable=quiet,
        transient=True,
    )
    with bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


def _report(paths: list[Path]) -> None:
    for path in paths:
        click.echo(str(path))


@cli.command()
@click.argument("methods", nargs=-1, required=True, metavar="METHOD…")
@click.option("--scenario", "file", type=click.Path(path_type=Path), metavar="SCENARIO.toml")
@scenario_arguments("uavs", "seed", "duration", "settings")
@_seeds
@_jobs
@_out("out/compare")
@_quiet
def compare(
    methods: tuple[str, ...], file: Path | None, seeds: int, jobs: int, out: Path, quiet: bool, **given: Any
) -> None:
    """Fly METHODs over the same seeds and plot them side by side, with 95 % intervals.

    \b
    Example: meanflock compare hjb mfgfl-hf --seeds 4 --duration 60
    """
    from groundstation import plots, study

    scenarios = {method: scenario.load(file, method=method, **given) for method in dict.fromkeys(methods)}
    first = next(iter(scenarios.values())).seed
    with _progress("comparing", quiet) as progress:
        flown = study.fly_all(scenarios, range(first, first + seeds), jobs, progress)
    study.save(flown.values(), out / "runs.jsonl")
    table = Table("method", *(title for _, title in plots.COMPARED), title=f"means of {seeds} runs")
    for method, summaries in flown.items():
        means = [_mean([plots.number(summary, key) for summary in summaries]) for key, _ in plots.COMPARED]
        table.add_row(method, *means)
    Console().print(table)
    _report(plots.write({"compare": plots.plot_compare(flown)}, out))


@cli.command()
@click.argument("swept", metavar="KEY=V1,V2,…")
@click.option("--methods", default="mfgfl-hf", show_default=True, metavar="M1,M2,…")
@click.option("--scenario", "file", type=click.Path(path_type=Path), metavar="SCENARIO.toml")
@scenario_arguments("uavs", "seed", "duration", "settings")
@_seeds
@_jobs
@_out("out/sweep")
@_quiet
def sweep(
    swept: str, methods: str, file: Path | None, seeds: int, jobs: int, out: Path, quiet: bool, **given: Any
) -> None:
    """Fly a scenario for several values of one key and plot what changes.

    \b
    Example: meanflock sweep wind.sigma=0.1,0.3 --methods hjb,mfgfl-hf --seeds 4 --duration 60
    """
    from groundstation import plots, study

    key, values = study.values_of(swept)
    names = [name.strip() for name in methods.split(",") if name.strip()]
    settings = tuple(given.pop("settings"))
    scenarios = {
        (value, method): scenario.load(file, method=method, settings=(*settings, f"{key}={_toml(value)}"), **given)
        for value in values
        for method in names
    }
    first = next(iter(scenarios.values())).seed
    with _progress("sweeping", quiet) as progress:
        flown = study.fly_all(scenarios, range(first, first + seeds), jobs, progress)
    study.save(flown.values(), out / "runs.jsonl")
    points = {value: {method: flown[value, method] for method in names} for value in values}
    _report(plots.write({"sweep": plots.plot_sweep(key, points)}, out))


@cli.command()
@click.argument("folder", metavar="RUN", type=click.Path(path_type=Path))
def plot(folder: Path) -> None:
    """Plot a finished run: paths and curves, as PNG and SVG in RUN/plots.

    \b
    Example: meanflock plot runs/20261121-101500-mfgfl-hf-s7
    """
    from groundstation import plots
    from groundstation.results import alone, completed

    if not folder.is_dir():
        raise BadInput(f"{folder}: no such run; name the folder of one")
    with alone(folder):
        completed(folder)
    _report(plots.write(plots.plot_run(folder), folder / "plots"))


@cli.command()
@click.option(
    "--seeds", type=click.IntRange(1), default=30, show_default=True, metavar="K", help="A point; 2: a quick look."
)
@click.option("--only", multiple=True, metavar="FIG", help="fig2 … fig8, repeatable: only what these need.")
@_jobs
@click.option("--backend", type=click.Choice(["loky", "dask"]), default="loky", show_default=True)
@click.option("--scheduler", metavar="ADDRESS", help="Of dask, e.g. tcp://127.0.0.1:8786.")
@_out("out/paper")
@_quiet
def paper(
    seeds: int, only: tuple[str, ...], jobs: int, backend: str, scheduler: str | None, out: Path, quiet: bool
) -> None:
    """Fly the paper's whole grid; write figures, tables, and a verdict for each of its claims.

    \b
    Interrupt and repeat it as you like: a finished run is never flown twice.
    Example: meanflock paper --seeds 2 --out out/paper
    """
    from groundstation.paper.experiments import run_grid
    from groundstation.paper.figures import FIGURES, draw
    from groundstation.paper.measure import measured
    from groundstation.paper.report import counts, write_report
    from groundstation.paper.verdict import evaluate

    wanted = [f"fig{name.removeprefix('fig')}" for name in only] or None
    unknown = sorted(set(wanted or ()) - set(FIGURES))
    if unknown:
        raise BadInput(f"--only {', '.join(unknown)}: no such figure; there are {', '.join(FIGURES)}")
    experiments = set().union(*(_FLOWN_FOR[name] for name in wanted)) if wanted else None
    results = run_grid(out, seeds, experiments, jobs, backend, scheduler, quiet)
    with _progress("theory", quiet) as progress:
        theory = measured(out, jobs=jobs, progress=progress)
    records = evaluate(results, theory)
    draw(results, out / "figures", wanted)
    paths = write_report(results, records, out, theory)
    for verdict, number in counts(records).items():
        click.echo(f"{verdict}: {number}", err=True)
    _report(paths)


_FLOWN_FOR: dict[str, set[str]] = {
    "fig2": {"s0"},
    "fig3": {"s0"},
    "fig4": {"s0"},
    "fig5": {"uavs"},
    "fig6": {"period"},
    "fig7": {"wind"},
    "fig8": {"offline", "trained"},
}


def _mean(values: list[float]) -> str:
    known = [value for value in values if value == value]  # NaN: nobody arrived
    return f"{sum(known) / len(known):.4g}" if known else "–"


def _toml(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)
