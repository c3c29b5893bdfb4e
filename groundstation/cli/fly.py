"""Commands that fly: run, resume."""

import json
import logging
import re
import sys
from contextlib import AbstractContextManager, nullcontext, redirect_stdout
from itertools import pairwise
from pathlib import Path
from typing import Any

import click
from rich.console import Console

from meanflock.groundstation import doctor as checks
from meanflock.groundstation.cli import display
from meanflock.groundstation.cli.arguments import (
    PATH,
    in_process_option,
    load_scenario,
    out_option,
    run_argument,
    scenario_arguments,
    telling,
    tls_option,
    uavs_per_process_option,
    warn_before_take_off,
)
from meanflock.groundstation.launch.progress import summary_table
from meanflock.groundstation.launch.resume import Back, back
from meanflock.groundstation.launch.run import Options, Run, fly
from meanflock.groundstation.results.run_folder import EVENTS, RECORDING, lost_everyone, said_of_loss
from meanflock.swarm import logs, scenario
from meanflock.swarm.errors import BadInput, RunFailed
from meanflock.swarm.net.access import Address
from meanflock.worldsim.summary import every_uav_was_lost, factor


class _Run(click.Command):
    """Command `run`, with an error of our own for a negative `--realtime`, which Click takes for a flag."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Check `--realtime`, then parse as usual."""
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
@click.option("--faults", type=PATH, metavar="FILE", help="Inject the faults of this script (TOML).")
@click.option("--record/--no-record", default=True, show_default=True, help="Write recording.rrd for the Rerun viewer.")
@click.option("--view", is_flag=True, help="Watch live in the Rerun viewer; needs a display.")
@click.option("--web", is_flag=True, help="With --view: watch in a browser, at the address printed; needs no display.")
@out_option("runs", "Where run folders are made.")
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
    faults: Path | None,
    realtime: str | None,
    record: bool,
    view: bool,
    web: bool,
    as_json: bool,
    **given: Any,
) -> None:
    """Fly a scenario once, by default the paper's.

    SCENARIO is a TOML file, or the name of one that comes with meanflock: crowd, faults, gusts, hierarchical, lossy,
    obstacles, paper, paper-printed, paper-slow, streams, swap, unknown, windmap, windy.

    Results are written to OUT/<id>/: summary, time series, events, recording.

    \b
    Example: meanflock run --method hjb --uavs 9 --set wind.sigma=0.2
    """
    script = scenario.read_faults(faults) if faults is not None else None
    with _prints_apart(as_json):
        flown = load_scenario(file, settings, method=method, uavs=uavs, seed=seed, duration=duration, faults=script)
        _refuse_if_too_large(flown, given["in_process"], given["uavs_per_process"])
    if given["log_format"] != logs.JSON:  # the world reports it
        warn_before_take_off([flown])
    if view and not record:
        raise BadInput("--view: shows what is recorded; leave out --no-record")
    if web and not view:
        raise BadInput("--web: says how to watch the flight; add --view")
    if view and not web:
        display.check("add --web to watch in a browser, or fly without --view and use `meanflock picture` afterwards")
    given["realtime"] = factor(realtime) if realtime is not None else None
    given["serve"] = ("127.0.0.1", checks.VIEWER_PORT) if view else None
    if web:
        _fly_in_a_browser(flown, as_json, **given)
    elif view:
        from meanflock.groundstation.recording.viewer import open_viewer

        _fly(flown, as_json, watch=open_viewer, **given)
    else:
        _fly(flown, as_json, record=record, **given)


def _fly_in_a_browser(flown: scenario.Scenario, as_json: bool, **given: Any) -> None:
    """Fly a scenario and show it on a page, live and then from its recording, until Ctrl-C."""
    from meanflock.groundstation.recording.web import WebPage

    with WebPage() as page:

        def watch(live_url: str) -> None:
            page.recording = live_url
            logs.tell(f"live at {page.url}")

        done = _fly(flown, as_json, watch=watch, **given)
        page.recording = done.folder / RECORDING
        logs.tell(f"{page.url} shows the recording until Ctrl-C")
        page.attend()


@click.command()
@run_argument
@scenario_arguments("plugin")
@in_process_option
@uavs_per_process_option
@tls_option
@click.option("--record/--no-record", default=True, show_default=True, help="Continue recording.rrd.")
@telling
def resume(folder: Path, as_json: bool, **given: Any) -> None:
    """Resume a run that did not finish, from its last checkpoint.

    RUN is its folder. The result is the same as without the interruption.

    \b
    Example: meanflock resume runs/20261121-101500-mfgfl-hf-s7
    """
    with _prints_apart(as_json):
        dead = back(folder)
        _refuse_if_too_large(dead.scenario, given["in_process"], given["uavs_per_process"])
    _fly(dead.scenario, as_json, dead, out=dead.folder.parent, **given)


def _fly(
    flown: scenario.Scenario,
    as_json: bool,
    dead: Back | None = None,
    *,
    metrics: str | None,
    log_format: str | None,
    quiet: bool,
    **given: Any,
) -> Run:
    """Fly a scenario, or the rest of a run, and print the result."""
    where = None if metrics is None else Address.parse("--metrics", metrics)
    only_logs = log_format == logs.JSON  # its lines name the run
    with _prints_apart(as_json):
        done = fly(flown, Options(metrics=where, log_format=log_format, quiet=quiet or only_logs, **given), dead)
    if as_json:
        click.echo(json.dumps(done.summary))
    else:
        Console().print(summary_table(done.summary))
    if every_uav_was_lost(flown, done.summary):
        raise RunFailed(lost_everyone(done.folder))
    if not only_logs:
        if (void := done.summary["rounds_void"]) and not done.summary["rounds"]:
            logs.tell(
                f"warning: nothing was federated: no model of another UAV arrived in {void} rounds, which were void",
                logging.WARNING,
            )
        if done.summary["lost"] and (why := said_of_loss(done.folder)):
            lost = done.summary["lost"]
            logs.tell(
                f"UAVs lost: {lost}; the first event: {why}; all events are in {done.folder / EVENTS}", logging.WARNING
            )
        logs.tell(f"run folder {done.folder}")
    return done


def _prints_apart(as_json: bool) -> AbstractContextManager[object]:
    """Redirect the output of plug-ins to standard error if `--json` promises one object on standard output."""
    return redirect_stdout(sys.stderr) if as_json else nullcontext()


def _refuse_if_too_large(flown: scenario.Scenario, in_process: bool, uavs_per_process: int) -> None:
    """Refuse a swarm that does not fit into memory."""
    processes = 0 if in_process else -(-flown.uavs // uavs_per_process)
    needs = [checks.memory(flown.uavs, processes, flown.declared.pairwise)]
    needs += [checks.open_files(flown.uavs, uavs_per_process)] if processes else []
    for finding in needs:
        if finding.verdict == "fails":
            raise BadInput(f"{finding.what}: {finding.found}; {finding.mend}")
