"""Commands that fly: run, resume."""

import json
import logging
import re
from itertools import pairwise
from pathlib import Path

import click
from rich.console import Console

from meanflock.groundstation import display
from meanflock.groundstation import doctor as checks
from meanflock.groundstation.cli_arguments import (
    in_process_option,
    scenario_arguments,
    telling,
    tls_option,
    uavs_per_process_option,
)
from meanflock.groundstation.progress import summary_table
from meanflock.groundstation.results import EVENTS, said_of_loss
from meanflock.groundstation.resume import back
from meanflock.groundstation.run import Options, Run, fly
from meanflock.swarm import logs, scenario
from meanflock.swarm.errors import BadInput
from meanflock.swarm.net.address import Address
from meanflock.worldsim.schedule import factor


class _Run(click.Command):
    """Click takes a number below zero for a flag; we say what is wrong with it."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """As any command does, once `--realtime` has been looked at."""
        for first, second in pairwise([*args, ""]):
            given = second if first == "--realtime" else first.removeprefix("--realtime=")
            if given != first and re.match(r"-[.\d]", given):
                factor(given)
        return super().parse_args(ctx, args)


@click.command(cls=_Run)
@scenario_arguments()
@in_process_option
@uavs_per_process_option
@click.option(
    "--realtime",
    is_flag=False,
    flag_value="1",
    metavar="[FACTOR]",
    help="Fly in real time, or FACTOR times faster; late commands are held.",
)
@click.option(
    "--faults", type=click.Path(path_type=Path), metavar="FILE", help="Inject the faults of this script (TOML)."
)
@click.option("--record/--no-record", default=True, show_default=True, help="Write recording.rrd for the Rerun viewer.")
@click.option("--view", is_flag=True, help="Watch live in the Rerun viewer; needs a display.")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("runs"),
    show_default=True,
    metavar="DIR",
    help="Where run folders are made.",
)
@click.option(
    "--endpoint",
    metavar="ADDRESS",
    help="Where the world listens, e.g. tcp/127.0.0.1:7447.  [default: a free port of this machine]",
)
@tls_option
@telling
def run(
    file: Path | None,
    method: str | None,
    uavs: int | None,
    seed: int | None,
    duration: float | None,
    settings: tuple[str, ...],
    in_process: bool,
    uavs_per_process: int,
    realtime: str | None,
    faults: Path | None,
    record: bool,
    view: bool,
    out: Path,
    endpoint: str | None,
    tls: Path | None,
    metrics: str | None,
    log_format: str | None,
    as_json: bool,
    quiet: bool,
) -> None:
    """Fly a scenario once, by default the paper's.

    SCENARIO is a TOML file, or the name of one that comes with meanflock: crowd, faults, gusts, hierarchical, lossy,
    obstacles, paper, paper-printed, paper-slow, streams, swap, unknown, windmap, windy.

    Results are written to OUT/<id>/: summary, time series, events, recording.

    \b
    Example: meanflock run --method hjb --uavs 9 --set wind.sigma=0.2
    """
    quiet = quiet or log_format == logs.JSON
    script = scenario.read_faults(faults) if faults is not None else None
    flown = scenario.load(file, settings, method=method, uavs=uavs, seed=seed, duration=duration, faults=script)
    _refuse_if_too_large(flown, 0 if in_process else uavs_per_process)
    if view:
        display.check(
            "fly without --view, then look with `meanflock picture` or with `meanflock view --web` in a browser"
        )
    options = Options(
        out=out,
        in_process=in_process,
        uavs_per_process=uavs_per_process,
        realtime=factor(realtime) if realtime is not None else None,
        record=record or view,
        serve=("127.0.0.1", checks.VIEWER_PORT) if view else None,
        endpoint=endpoint,
        tls=tls,
        quiet=quiet,
        view=view,
        metrics=_metrics(metrics),
        log_format=log_format,
    )
    _tell(fly(flown, options), as_json, log_format)


@click.command()
@click.argument("folder", metavar="RUN", type=click.Path(path_type=Path))
@scenario_arguments("plugin")
@in_process_option
@uavs_per_process_option
@tls_option
@click.option("--record/--no-record", default=True, show_default=True, help="Continue recording.rrd.")
@telling
def resume(
    folder: Path,
    in_process: bool,
    uavs_per_process: int,
    tls: Path | None,
    record: bool,
    metrics: str | None,
    log_format: str | None,
    as_json: bool,
    quiet: bool,
) -> None:
    """Resume a run that did not finish, from its last checkpoint.

    RUN is its folder. The result is the same as without the interruption.

    \b
    Example: meanflock resume runs/20261121-101500-mfgfl-hf-s7
    """
    quiet = quiet or log_format == logs.JSON
    dead = back(folder)
    _refuse_if_too_large(dead.scenario, 0 if in_process else uavs_per_process)
    options = Options(
        out=dead.folder.parent,
        in_process=in_process,
        uavs_per_process=uavs_per_process,
        tls=tls,
        record=record,
        quiet=quiet,
        metrics=_metrics(metrics),
        log_format=log_format,
    )
    _tell(fly(dead.scenario, options, dead), as_json, log_format)


def _metrics(given: str | None) -> Address | None:
    return None if given is None else Address.parse("--metrics", given)


def _tell(done: Run, as_json: bool, log_format: str | None) -> None:
    if as_json:
        click.echo(json.dumps(done.summary))
    else:
        Console().print(summary_table(done.summary))
    if log_format != logs.JSON:  # each of whose lines names the run
        if done.summary["lost"] and (why := said_of_loss(done.folder)):
            logs.tell(
                f"{done.summary['lost']} lost; the first: {why}; all are in {done.folder / EVENTS}", logging.WARNING
            )
        logs.tell(f"run folder {done.folder}")


def _refuse_if_too_large(flown: scenario.Scenario, uavs_per_process: int) -> None:
    """A swarm that does not fit into memory is refused before it starts; 0 UAVs per process: all in this one."""
    processes = -(-flown.uavs // uavs_per_process) if uavs_per_process else 0
    needs = [checks.memory(flown.uavs, processes, flown.declared.pairwise)]
    needs += [checks.open_files(flown.uavs, uavs_per_process)] if processes else []
    for finding in needs:
        if finding.verdict == "fails":
            raise BadInput(f"{finding.what}: {finding.found}; {finding.mend}")
