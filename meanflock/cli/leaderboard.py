"""The command `leaderboard`: controllers over missions."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from meanflock.cli import completion
from meanflock.cli.arguments import (
    given_learner,
    given_radio,
    number_option,
    out_option,
    quiet_option,
    report,
    scenario_arguments,
)
from meanflock.cli.study_arguments import (
    WorkersOptions,
    list_option,
    lists,
    names,
    progress_of,
    store_in,
    workers_options,
)

if TYPE_CHECKING:
    from meanflock.studies.leaderboard.board import Board

_FIRST_SEED = 8001
_DEFAULT_POLICY = "event-4"  # tests compare it with the scenario's


@click.command(cls=lists("--missions", "--controllers", "--policies"))
@list_option("--missions", "NAME…", "Missions to fly, or all", "all", completion.missions, default=("all",))
@list_option(
    "--controllers", "NAME…", "Controllers or named rows, or all", "all", completion.controllers, default=("all",)
)
@list_option(
    "--policies",
    "NAME…",
    "Policies by which UAVs share their states: tick, event, event-4. Rows that share none fly once",
    _DEFAULT_POLICY,
    default=(_DEFAULT_POLICY,),
)
@scenario_arguments("radio", "learner", "plugin")
@number_option("--seeds", "K", 30, "Flights of each, with one seed each.")
@number_option("--first-seed", "S", _FIRST_SEED, "First of the seeds.", least=0)
@workers_options
@out_option("out/leaderboard")
@quiet_option
def leaderboard(
    missions: tuple[str, ...],
    controllers: tuple[str, ...],
    policies: tuple[str, ...],
    seeds: int,
    first_seed: int,
    workers: WorkersOptions,
    out: Path,
    quiet: bool,
) -> None:
    """Rank controllers over the same missions and seeds.

    Writes tables with 95 % intervals, which controller is significantly best at what, and Pareto plots. Repeat an
    interrupted command to fly only what is missing.

    \b
    Example:
      meanflock leaderboard --missions paper --controllers mfgfl-h plan --seeds 4
    """
    from meanflock.studies.leaderboard import missions as known
    from meanflock.studies.leaderboard import rows
    from meanflock.studies.leaderboard.contest import Contest
    from meanflock.studies.leaderboard.page import write
    from meanflock.studies.runner import terminable

    chosen = known.chosen(names(missions))
    if names(controllers) != [rows.ALL]:
        known.refuse_rows(chosen, "leave out --controllers, or remove `method` from a group")
    contest = Contest(
        chosen,
        rows.chosen(names(controllers)),
        seeds,
        first_seed,
        rows.policies(names(policies)),
        given_learner(),
        given_radio(),
    )
    with terminable(out):
        with (
            workers.start() as jobs,
            store_in(out) as store,
            progress_of("leaderboard", quiet) as progress,
        ):
            board = contest.fly(jobs, progress, store)
        _tell(board)
        report(write(board, out))


def _tell(board: "Board") -> None:
    """Print the tables of a board."""
    from rich.console import Console

    from meanflock.cli.tables import print_table
    from meanflock.studies.leaderboard import tables, terminal

    console = Console()
    for course in board.courses:
        print_table(terminal.table(course))
        conditions = tables.conditions(course, board.policies).replace("`", "")
        for note in filter(None, (conditions, *tables.notes(course), *tables.mixed(course))):
            console.print(note, style="dim", markup=False, highlight=False)
        console.print()
    console.print(terminal.CAPTION, style="dim italic", highlight=False)
