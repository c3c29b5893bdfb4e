"""The command `frontier`: the fewest bits to send for flights without collisions."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from meanflock.cli import completion
from meanflock.cli.arguments import number_option, out_option, quiet_option, report, scenario_arguments
from meanflock.cli.study_arguments import (
    WorkersOptions,
    list_option,
    lists,
    names,
    progress_of,
    store_in,
    workers_options,
)
from meanflock.swarm.errors import BadInput

if TYPE_CHECKING:
    from meanflock.studies.frontier.record import FrontierRecord

_FIRST_SEED = 94001
_MOST_FLIGHTS = 1000  # a test compares it with that of the study
_MISSIONS = ("streams",)
_CONTROLLERS = ("plan", "orca", "bvc", "vasarhelyi", "cruise-ecbf")
_UAVS, _FULL_UAVS = (25, 64), (25, 64, 100)
_OUTAGES, _FULL_OUTAGES = (3.0, 30.0, 50.0), (3.0, 12.0, 30.0, 50.0, 70.0)  # %
_TARGETS, _FULL_TARGETS = (0.9, 0.95), (0.9, 0.95, 0.99)


def _words(values: tuple[Any, ...]) -> str:
    return " ".join(str(value).removesuffix(".0") for value in values)


def _sizes(given: tuple[str, ...]) -> list[int]:
    words = names(given)
    for word in words:
        if not word.isdecimal() or int(word) < 1:
            raise BadInput(f"--uavs {word}: give whole numbers of UAVs, for example 25 64")
    return [*dict.fromkeys(map(int, words))]


def _losses(given: tuple[str, ...]) -> list[float]:
    losses = []
    for word in names(given):
        try:
            loss = float(word.removesuffix("%"))
        except ValueError:
            loss = -1.0
        if not 0.0 < loss < 100.0:
            raise BadInput(f"--outages {word}: give shares of broadcasts in per cent, between 0 and 100")
        losses.append(loss)
    return [*dict.fromkeys(losses)]


@click.command(cls=lists("--missions", "--controllers", "--uavs", "--outages", "--policies"))
@list_option("--missions", "NAME…", "Missions to fly, or all", _words(_MISSIONS), completion.missions)
@list_option(
    "--controllers", "NAME…", "Controllers or named rows, or all", _words(_CONTROLLERS), completion.controllers
)
@list_option("--uavs", "N…", "Numbers of UAVs", _words(_UAVS))
@list_option("--outages", "PERCENT…", "Shares of the broadcast states that the radio loses", _words(_OUTAGES))
@list_option("--policies", "NAME…", "Policies of communication to choose from", "all")
@click.option(
    "--full",
    is_flag=True,
    help="Fly 25, 64 and 100 UAVs, outages of 3, 12, 30, 50 and 70 %, and also show 99 % free flights.",
)
@scenario_arguments("plugin")
@click.option(
    "--seeds",
    type=click.IntRange(1, _MOST_FLIGHTS),
    metavar="K",
    help="Most flights of a policy in a cell, and most again to confirm it.  [default: as many as the targets take]",
)
@number_option("--failures", "C", 0, "Flights with a collision that a plan allows; more take more flights.", least=0)
@number_option("--first-seed", "S", _FIRST_SEED, "First of the seeds.", least=0)
@workers_options
@out_option("out/frontier")
@quiet_option
def frontier(
    missions: tuple[str, ...],
    controllers: tuple[str, ...],
    uavs: tuple[str, ...],
    outages: tuple[str, ...],
    policies: tuple[str, ...],
    full: bool,
    seeds: int | None,
    failures: int,
    first_seed: int,
    workers: WorkersOptions,
    out: Path,
    quiet: bool,
) -> None:
    """Find the fewest bits to send for flights without collisions.

    For each controller, mission, outage and number of UAVs, searches for the cheapest policy of communication of which
    the flights show that 90 % and 95 % are free of collisions. Repeat an interrupted command to fly only what is
    missing.

    \b
    Example:
      meanflock frontier --controllers orca vasarhelyi --uavs 25 --outages 30 50
    """
    from meanflock.studies.frontier.grid import Extent, FrontierGrid
    from meanflock.studies.frontier.policies import check
    from meanflock.studies.leaderboard import missions as known
    from meanflock.studies.leaderboard import rows
    from meanflock.studies.runner import terminable

    chosen = [name for name in names(policies) if name != "all"]
    check(chosen)
    flown = known.chosen(names(missions) or _MISSIONS)
    known.refuse_rows(flown, "remove `method` from a group")
    extent = Extent(
        flown,
        rows.chosen(names(controllers) or _CONTROLLERS),
        _sizes(uavs) or (_FULL_UAVS if full else _UAVS),
        [loss / 100.0 for loss in _losses(outages) or (_FULL_OUTAGES if full else _OUTAGES)],
        _FULL_TARGETS if full else _TARGETS,
    )
    grid = FrontierGrid(extent, failures, seeds, first_seed, chosen)
    with terminable(out):
        with (
            workers.start() as jobs,
            store_in(out) as store,
            progress_of("frontier", quiet) as progress,
        ):
            store.claim()
            record = grid.fly(jobs, progress, store)
        _tell(record)
        report(_written(record, out))


def _written(record: "FrontierRecord", out: Path) -> list[Path]:
    from meanflock.studies.frontier import picture

    return [*record.write(out), *picture.write(record, out / "pictures")]


def _tell(record: "FrontierRecord") -> None:
    """Print the tables of a frontier."""
    from rich.console import Console

    from meanflock.cli.tables import print_table
    from meanflock.studies.frontier import terminal

    console = Console()
    for table in terminal.tables(record):
        print_table(table)
        console.print()
    for note in terminal.notes(record):
        console.print(note, style="dim", markup=False, highlight=False)
    console.print(terminal.CAPTION, style="dim italic", highlight=False)
