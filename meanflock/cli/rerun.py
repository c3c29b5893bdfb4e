"""The commands `study`: what can be done with a study that has flown."""

from pathlib import Path

import click

from meanflock.cli.arguments import PATH, CommandGroup, quiet_option, scenario_arguments
from meanflock.cli.study_arguments import WorkersOptions, progress_of, store_in, workers_options
from meanflock.swarm import logs
from meanflock.swarm.errors import BadInput, RunFailed

_MOST = 20  # differences that are printed


@click.group(cls=CommandGroup)
def study_group() -> None:
    """Fly a study again, and say whether it is the same.

    \b
    Example: meanflock study rerun out/sweep/study.json
    """


@study_group.command()
@click.argument("file", metavar="FILE", type=PATH)
@scenario_arguments("plugin")
@workers_options
@click.option(
    "--out", type=PATH, metavar="DIR", help="Where flights are kept meanwhile.  [default: rerun, beside FILE]"
)
@quiet_option
def rerun(file: Path, workers: WorkersOptions, out: Path | None, quiet: bool) -> None:
    """Fly a study again, and say which flights differ.

    FILE is the study.json that sweep and compare write. All flights are flown again, with the same scenarios and seeds,
    and compared bit by bit. Repeat an interrupted command to fly only what is missing. Exit code 0: all are the same;
    1: some differ; 2: the file cannot be used, or another version of meanflock flew.

    \b
    Example: meanflock study rerun out/sweep/study.json
    """
    from meanflock.cli.study_tables import differences_table
    from meanflock.cli.tables import print_table
    from meanflock.studies.rerun import RERUN, Study
    from meanflock.studies.runner import terminable
    from meanflock.studies.study_file import STUDY_FILE, versions_here

    study = Study(file)
    here = versions_here()
    for name, was in study.record.versions.items():
        if was != here[name]:
            logs.show(f"note: flown with {name} {was}, and here it is {here[name]}; last bits may differ")
    out = out or file.parent / RERUN
    if (out / STUDY_FILE).exists():
        raise BadInput(f"--out {out}: it has a study of its own; name another folder")
    with terminable(out), workers.start() as jobs, store_in(out) as store, progress_of("rerun", quiet) as progress:
        differences = study.fly(jobs, progress, store)
    if not differences:
        click.echo(f"All {study.flights} flights are the same.")
        return
    table = differences_table(study.record.names, differences[:_MOST])
    print_table(table)
    if more := len(differences) - table.row_count:
        click.echo(f"{more} more")
    flights = {(difference.point, difference.seed) for difference in differences}
    raise RunFailed(f"{file}: {len(flights)} of {study.flights} flights differ")
