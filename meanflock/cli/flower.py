"""Command `flower`: flies a Flower app as its author wrote it."""

import json
import logging
import re
import tomllib
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from meanflock.cli.arguments import (
    PATH,
    in_process_option,
    out_option,
    scenario_arguments,
    telling,
    uavs_per_process_option,
)
from meanflock.cli.fly import _forker
from meanflock.results.run_folder import Failures
from meanflock.swarm import logs
from meanflock.swarm.errors import BadInput, RunFailed, available, meant

if TYPE_CHECKING:
    from meanflock.flower.app import App
    from meanflock.launch.run import EndedRun

RESULT = "result.json"
_PAIR = re.compile(r"""(?:[^\s"']|"(?:\\.|[^"\\])*"|'[^']*')+""")  # signs up to a space that is not quoted


@click.command()
@click.argument("app", metavar="APP_DIR", type=PATH)
@click.option("--mission", metavar="SCENARIO", help="Scenario that is flown.  [default: paper]")
@click.option("--run-config", metavar="'KEY=VALUE …'", default="", help="Configuration over that of the app.")
@scenario_arguments("method", "uavs", "seed", "duration", "settings", "until", "plugin")
@in_process_option
@uavs_per_process_option
@out_option("runs", "Where run folders are made.")
@telling
def flower(
    app: Path,
    mission: str | None,
    run_config: str,
    method: str | None,
    uavs: int | None,
    seed: int | None,
    duration: float | None,
    settings: tuple[str, ...],
    in_process: bool,
    out: Path,
    as_json: bool,
    **given: Any,
) -> None:
    """Fly a Flower app unmodified: the radio carries its models.

    APP_DIR is the folder of the app, with its pyproject.toml. ClientApps train on the UAVs, the ServerApp runs in the
    leader. A reply that the radio loses is an error, as of a node that fails. What the app reports is written to
    OUT/<id>/result.json, with bits, airtime and failures of every round.

    \b
    Example:
      meanflock flower app --mission lossy --uavs 10 --set federation.retries=1
    """
    with available("the command `flower`", "flower"):
        from meanflock.flower import plugin
        from meanflock.flower.app import App
    from meanflock.studies.swept import refuse_setting
    from meanflock.swarm import plugins

    described = App.read(app)
    _ = described.client_app  # imported before the plug-in, which an error would name
    for key, value in _pairs(run_config).items():
        if key not in described.config:
            there = ", ".join(sorted(described.config)) or "none"
            similar = meant(key, described.config)
            raise BadInput(f"--run-config {key}: the app has no such key; there are {there}{similar}")
        described.config[key] = value
    for key in ("training.learner", "federation.aggregation"):
        refuse_setting(key, settings, "is the app")
    name = described.name
    fixed = (f"training.learner={name}", f"federation.aggregation={name}", "federation.fraction=1.0", "stop=rounds")
    file = None if mission is None else Path(mission)
    keys: dict[str, Any] = {"method": method or "orca", "uavs": uavs, "seed": seed, "duration": duration}
    rounds = described.rounds
    with ExitStack() as stack:
        plugins.load_files([stack.enter_context(plugin.written(described, out / ".flower"))])
        forker = stack.enter_context(_forker(in_process))
        from meanflock.cli import flight
        from meanflock.cli.arguments import load_scenario
        from meanflock.launch.run import RunStopped
        from meanflock.results.scenario_name import scenario_name

        with flight.prints_apart(as_json):
            flown = load_scenario(file, (*fixed, *settings), **keys)
        if flown.groups:
            raise BadInput(f"{mission}: a Flower app trains all UAVs, and the scenario has `[[groups]]`; take another")
        if duration is None and rounds:
            flown = flown.replace(duration=(rounds + 2) * flown.period_ticks * flown.dt)
        try:
            done = flight.run_loaded(
                flown,
                as_json=as_json,
                mission=scenario_name(file),
                in_process=in_process,
                forker=forker,
                out=out,
                realtime=None,
                record=False,
                view=False,
                web=False,
                steer=None,
                endpoint=None,
                tls=None,
                **given,
            )
        except RunStopped as stopped:
            _write_result(stopped.ended, described, interrupted=True)
            raise
    ended = _write_result(done, described)
    _judge(done, ended, rounds)


def _pairs(text: str) -> dict[str, Any]:
    """Keys and values in a text such as Flower's `--run-config`: TOML, but pairs are separated by spaces."""
    pairs: dict[str, Any] = {}
    for pair in _PAIR.findall(text):
        key, sign, value = pair.partition("=")
        try:
            if not (key and sign):
                raise ValueError("no `=`")
            pairs[key] = tomllib.loads(f"value = {value}")["value"]
        except ValueError as error:
            raise BadInput(f"--run-config {pair}: expected key=value, with a value as in TOML: {error}") from error
    return pairs


def _write_result(done: "EndedRun", described: "App", **marks: bool) -> list[dict[str, Any]]:
    """Write what came of an app into the folder of its run, with `marks` of the flight; returns its rounds."""
    import pyarrow.parquet as pq

    from meanflock.results.rounds_table import METRIC, ROUNDS

    path = done.folder / ROUNDS
    ended: list[dict[str, Any]] = pq.read_table(path).to_pylist() if path.exists() else []
    same = ("round", "sim_time_s", "bits", "airtime_s", "sent", "received", "retries")
    table = [
        {name: one[name] for name in same}
        | {name.removeprefix(METRIC): value for name, value in one.items() if name.startswith(METRIC)}
        for one in ended
    ]
    result = {"app": described.name, "config": described.config, **marks, "rounds": table, "summary": done.summary}
    (done.folder / RESULT).write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    return ended


def _judge(done: "EndedRun", ended: list[dict[str, Any]], rounds: int) -> None:
    """Say what went wrong in a flight. `rounds`: that the app was to have.

    Raises:
        RunFailed: the ServerApp failed, or never got a reply.
    """
    from meanflock.results.rounds_table import MEAN, METRIC

    failures = Failures.of_run(done.folder)
    if failures.rules and ended and ended[-1]["outcome"] == "void":  # it ends the flight in that round
        raise RunFailed(failures.rules[-1])
    if ended and not any(one["received"] for one in ended):
        why = next(iter(failures.losses + failures.trainings), "the radio lost all of them")
        raise RunFailed(f"no reply reached the ServerApp in {len(ended)} rounds: {why}")
    if (target := done.summary["until"]) is not None:
        names = {
            name.removeprefix(METRIC).removeprefix(MEAN)
            for one in ended
            for name in one
            if name.startswith((METRIC, MEAN))
        }
        if ended and (metric := target["metric"]) not in names:
            logs.note(f"no round has a metric {metric!r}{meant(metric, names)}", logging.WARNING)
        if target["reached"]:
            return
    if done.summary["ticks"] >= done.scenario.max_ticks:  # the ServerApp has not ended
        logs.note(
            f"the flight ended after {len(ended)} rounds while the ServerApp waited for replies; fly longer "
            "with --duration, or open rounds more often with --set federation.period=TICKS",
            logging.WARNING,
        )
    elif len(ended) < rounds:
        logs.note(f"the ServerApp ended after {len(ended)} rounds; num-server-rounds is {rounds}", logging.WARNING)
