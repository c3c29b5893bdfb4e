"""Flights of the commands `run` and `resume`: the checks before take-off, and what is printed afterwards."""

import json
import logging
import sys
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from meanflock.cli import display
from meanflock.cli.arguments import given_plugins, load_scenario
from meanflock.cli.catalogue import KEYS
from meanflock.federation.plan import plan_of, plugins_of
from meanflock.launch import doctor as checks
from meanflock.launch.memory import learner_memory, pair_bytes
from meanflock.launch.options import FlightOptions, records
from meanflock.launch.run import EndedRun, fly
from meanflock.net.access import Address
from meanflock.results import disk
from meanflock.results.scenario_name import scenario_name
from meanflock.studies import before_take_off
from meanflock.swarm import logs, paths, plugins, scenario
from meanflock.swarm.errors import BadInput, RunFailed
from meanflock.swarm.scenario.values import as_builtins, with_keys
from meanflock.worldsim.clocks import factor
from meanflock.worldsim.summary import every_uav_was_lost

if TYPE_CHECKING:
    from meanflock.launch.resume import Back


def run(
    file: Path | None,
    settings: Sequence[str],
    *,
    faults: Path | None,
    keys: dict[str, Any],
    as_json: bool,
    **given: Any,
) -> EndedRun:
    """Fly a scenario that is loaded first.

    Args:
        file, settings, keys: the scenario, as for `load_scenario`. faults: a fault script.
        given: as for `run_loaded`.
    """
    script = scenario.read_faults(faults) if faults is not None else None
    with prints_apart(as_json):
        flown = load_scenario(file, settings, **keys, faults=None if script is None else [])
        if script is not None:  # apart from the scenario, so that errors name its file
            flown = with_keys(as_builtins(flown), {"faults": script}, scenario.Scenario, str(faults))
    return run_loaded(flown, as_json=as_json, mission=scenario_name(file), **given)


def run_loaded(
    flown: scenario.Scenario,
    *,
    realtime: str | None,
    record: bool | None,
    view: bool,
    web: bool,
    as_json: bool,
    **given: Any,
) -> EndedRun:
    """Fly a scenario. `given`: fields of `FlightOptions`, with `metrics` as text."""
    if view and record is False:
        raise BadInput("--view: shows what is recorded; leave out --no-record")
    if web and not view:
        raise BadInput("--web: says how to watch the flight; add --view")
    with prints_apart(as_json):
        record = _records(view or record, "--view" if view else "--record", **given)
        _refuse_if_too_large(flown, given["in_process"], given["uavs_per_process"])
        disk.check(flown, given["out"], record, disk.OF_RUN)
    if given["log_format"] != logs.JSON:  # the world reports it
        before_take_off.warn((), {(): flown})
        _warn_of_unused(flown)
    if view and not web:
        display.check("add --web to watch in a browser, or fly without --view and use `meanflock picture` afterwards")
    given["realtime"] = factor(realtime) if realtime is not None else None
    if (where := given["steer"]) is not None:
        given["steer"] = Address.parse("--steer", where)
    given["serve"] = ("127.0.0.1", checks.VIEWER_PORT) if view else None
    if web:
        return _fly_in_a_browser(flown, as_json, **given)
    if view:
        from meanflock.recording.viewer import open_viewer

        return _fly(flown, as_json, watch=open_viewer, **given)
    return _fly(flown, as_json, record=record, **given)


def _warn_of_unused(flown: scenario.Scenario) -> None:
    """Warn of files of `--plugin` of which the flight uses no plug-in."""
    used = {(kind, name) for kind, name, _ in plugins_of(flown)}
    for file in given_plugins():
        source = str(paths.given(file.resolve()))
        there = [(plugin.kind, plugin.name) for plugin in plugins.installed() if plugin.source == source]
        if used.isdisjoint(there):
            named = " and no ".join(f"{kind} {name!r}" for kind, name in there)
            keys = " or ".join(f"--set {KEYS[kind]}={name}" for kind, name in there)
            logs.note(f"--plugin {file}: this flight uses no {named}; to fly it, add {keys}", logging.WARNING)


def _fly_in_a_browser(flown: scenario.Scenario, as_json: bool, **given: Any) -> EndedRun:
    """Fly a scenario and show it on a page, live and then from its recording, until Ctrl-C."""
    from meanflock.recording.web import WebPage
    from meanflock.results.run_folder import RECORDING

    with WebPage() as page:

        def watch(live_url: str) -> None:
            page.recording = live_url
            logs.show(f"live at {page.url}")

        done = _fly(flown, as_json, watch=watch, **given)
        page.recording = done.folder / RECORDING
        logs.show(f"{page.url} shows the recording until Ctrl-C")
        page.attend()
        return done


def resume(folder: Path, as_json: bool, record: bool | None, **given: Any) -> None:
    """Fly the rest of the run in a folder; `given` as for `run`."""
    from meanflock.launch.resume import back

    with prints_apart(as_json):
        dead = back(folder)
        record = _records(record, "--record", **given)
        _refuse_if_too_large(dead.scenario, given["in_process"], given["uavs_per_process"])
        disk.check(dead.scenario, dead.folder, record, disk.OF_RESUME, dead.past.rows.num_rows - 1)
    _fly(dead.scenario, as_json, dead, out=dead.folder.parent, record=record, **given)


def _fly(
    flown: scenario.Scenario,
    as_json: bool,
    dead: "Back | None" = None,
    *,
    metrics: str | None,
    log_format: str | None,
    quiet: bool,
    **given: Any,
) -> EndedRun:
    """Fly a scenario, or the rest of a run, and print the result."""
    where = None if metrics is None else Address.parse("--metrics", metrics)
    only_logs = log_format == logs.JSON  # its lines name the run
    with prints_apart(as_json):
        done = fly(flown, FlightOptions(metrics=where, log_format=log_format, quiet=quiet or only_logs, **given), dead)
    from rich.console import Console

    from meanflock.cli.tables import print_table
    from meanflock.launch.progress import groups_table, summary_table
    from meanflock.results.run_folder import EVENTS, Failures, lost_everyone

    if as_json:
        click.echo(json.dumps(done.summary))
    else:
        Console().print(summary_table(done.summary, flown.until))
        if groups := done.summary["groups"]:
            print_table(groups_table(groups))
    if every_uav_was_lost(flown, done.summary):
        raise RunFailed(lost_everyone(done.folder))
    if not only_logs:
        events, void = f"all events are in {done.folder / EVENTS}", done.summary["rounds_void"]
        failures = Failures.of_run(done.folder)
        if failures.rules:
            rounds = f"rounds void, for any reason: {void}"
            logs.note(f"the aggregation rule failed: {failures.rules[0]}; {rounds}; {events}", logging.WARNING)
        elif void and not done.summary["rounds"]:
            why = "no model of another UAV arrived"
            if refused := done.summary["uploads_refused"]:
                why = f"uploads that arrived and could not be averaged: {refused}"
            rounds = "the only round was" if void == 1 else f"all {void} rounds were"
            logs.note(f"nothing was federated: {why}; {rounds} void", logging.WARNING)
        *declared, examples = plan_of(flown).declared.measured or ("",)
        if declared and done.summary["rounds"] and done.summary["diagnostics_mean"][examples] is None:
            logs.note(
                f"no training gave all metrics that the learner declares, so these are unknown: {', '.join(declared)}; "
                "return all of them in `mf.Trained.metrics`, or declare fewer",
                logging.WARNING,
            )
        if failed := failures.trainings:
            trainings = f"{len(failed)} training{'s' * (len(failed) > 1)} failed"
            logs.note(f"{trainings}; the first: {failed[0]}", logging.WARNING)
        if (lost := done.summary["lost"]) and failures.losses:
            logs.show(f"UAVs lost: {lost}; the first event: {failures.losses[0]}; {events}", logging.WARNING)
        logs.show(f"run folder {done.folder}")
    return done


def prints_apart(as_json: bool) -> AbstractContextManager[object]:
    """Redirect the output of plug-ins to standard error if `--json` promises one object on standard output."""
    return redirect_stdout(sys.stderr) if as_json else nullcontext()


def _records(wanted: bool | None, option: str, *, quiet: bool, log_format: str | None, **_: Any) -> bool:
    return records(wanted, option, quiet or log_format == logs.JSON)


def _refuse_if_too_large(flown: scenario.Scenario, in_process: bool, uavs_per_process: int) -> None:
    """Refuse a swarm that does not fit into memory."""
    processes = 0 if in_process else -(-flown.uavs // uavs_per_process)
    needs = [checks.memory(flown.uavs, processes, pair_bytes(flown), learner_memory(flown))]
    needs += [checks.open_files(flown.uavs, uavs_per_process)] if processes else []
    for finding in needs:
        if finding.verdict == "fails":
            raise BadInput(f"{finding.check}: {finding.found}; {finding.remedy}")
