"""Commands about stored runs: list, show, diff."""

import json
from pathlib import Path

import click

from meanflock.cli import completion
from meanflock.cli.arguments import PATH, RUN, quiet_option, report, run_argument
from meanflock.cli.study_arguments import progress_of

_json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON on stdout.")


@click.command("list")
@click.argument("folder", metavar="[FOLDER]", type=PATH, default=Path("runs"))
@_json_option
@click.option("--html", type=PATH, metavar="FILE", help="Write a page with a picture of each run to FILE instead.")
@quiet_option
def list_runs(folder: Path, as_json: bool, html: Path | None, quiet: bool) -> None:
    """List the runs in a folder, the latest first.

    FOLDER has run folders, by default `runs`. The mission is the shipped scenario that is nearest to the run's; +2
    means that two more keys differ from it.

    \b
    Example: meanflock list --html runs.html
    """
    from meanflock.cli.run_tables import list_table, record
    from meanflock.cli.tables import print_table
    from meanflock.results.stored_run import runs_in
    from meanflock.swarm.errors import BadInput

    if as_json and html is not None:
        raise BadInput("--json and --html: give one of them")
    if html is not None:
        from meanflock.results.plots import gallery
    with progress_of("reading", quiet) as progress:
        runs = runs_in(folder, progress)
    if as_json:
        click.echo(json.dumps([record(run) for run in runs], indent=1))
    elif html is not None:
        with progress_of("drawing", quiet) as progress:
            report([gallery.write(runs, folder, html, progress)])
    elif not runs:
        click.echo(f"{folder}: no runs; `meanflock run` flies one")
    else:
        print_table(list_table(runs))


@click.command()
@run_argument
@_json_option
@click.option("--rounds", is_flag=True, help="Show the rounds of the federation instead, a line each.")
def show(folder: Path, as_json: bool, rounds: bool) -> None:
    """Show a run: what was flown, what came of it, and its files.

    RUN is its folder, or `latest`. Of the scenario it shows the keys that differ from the paper's. With --rounds it
    shows what became of the uploads of each round, what was sent until its end, and the means of the diagnostics then.

    \b
    Example: meanflock show runs/20261121-101500-mfgfl-hf-s7 --rounds
    """
    from meanflock.cli import run_tables
    from meanflock.results.stored_run import stored_run

    run = stored_run(folder)
    if rounds:
        run_tables.print_rounds(folder, as_json)
    elif as_json:
        click.echo(json.dumps(run_tables.full_record(run), indent=1))
    else:
        run_tables.print_run(run)


@click.command()
@click.argument("first", metavar="A", type=RUN, shell_complete=completion.runs)
@click.argument("second", metavar="B", type=RUN, shell_complete=completion.runs)
@_json_option
def diff(first: Path, second: Path, as_json: bool) -> None:
    """Compare two runs: which keys and which figures differ.

    A and B are their folders, or `latest`. Both runs must have finished. Times of this computer are not compared.

    \b
    Example:
      meanflock diff runs/20261121-101500-hjb-s7 runs/20261121-101700-mfg-s7
    """
    from meanflock.cli import run_tables
    from meanflock.results.run_difference import difference
    from meanflock.results.stored_run import finished_run

    found = difference(finished_run(first), finished_run(second))
    if as_json:
        click.echo(json.dumps(found.record(), indent=1))
    else:
        run_tables.print_difference(found)
