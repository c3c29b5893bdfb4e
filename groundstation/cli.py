"""The command line. A verb is a call of the library; what is here is flags, words and exit codes."""

import json
import logging
import os
import re
import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.table import Table

from meanflock.groundstation import catalogue, display
from meanflock.groundstation import doctor as checks
from meanflock.groundstation.progress import summary_table
from meanflock.groundstation.results import to_toml
from meanflock.groundstation.resume import back
from meanflock.groundstation.run import Options, Run, fly
from meanflock.swarm import __version__, logs, plugins, scenario
from meanflock.swarm.errors import EXIT_BAD_INPUT, EXIT_DONE, EXIT_RUN_FAILED, BadInput, MeanflockError
from meanflock.swarm.net.address import Address
from meanflock.swarm.net.refusals import divert
from meanflock.worldsim.schedule import factor

_METHODS = " | ".join(plugins.names("controller"))


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(__version__, prog_name="meanflock")
def cli() -> None:
    """A swarm of UAVs that learns, in flight and over a radio it pays for by the bit, to travel as a flock.

    \b
    Exit codes: 0 done, 1 the run failed or was interrupted, 2 bad input (nothing was written).
    Example: meanflock run --method mfgfl-hf --seed 7
    """


def _register(_context: click.Context, _parameter: click.Parameter, files: tuple[Path, ...]) -> None:
    plugins.load_files(files)


_OF_A_SCENARIO = {
    "file": click.argument("file", metavar="[SCENARIO.toml]", required=False, type=click.Path(path_type=Path)),
    "method": click.option("--method", metavar="NAME", help=f"{_METHODS}"),
    "uavs": click.option("--uavs", type=int, metavar="N", help="Number of UAVs."),
    "seed": click.option("--seed", type=int, metavar="S", help="Seed of all randomness."),
    "duration": click.option("--duration", type=float, metavar="SECONDS", help="The run ends at the latest then."),
    "settings": click.option(
        "--set", "settings", multiple=True, metavar="KEY=VALUE", help="Any scenario key, e.g. wind.sigma=0.2."
    ),
    "plugin": click.option(
        "--plugin",
        multiple=True,
        type=click.Path(path_type=Path),
        metavar="FILE.py",
        callback=_register,
        expose_value=False,
        is_eager=True,  # before anything asks for what is in it
        help="A file with a controller, an aggregation rule, a channel or a vehicle of yours, repeatable.",
    ),
}


class _Run(click.Command):
    """Click takes a number below zero for a flag; we say what is wrong with it."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """As any command does, once `--realtime` has been looked at."""
        for first, second in pairwise([*args, ""]):
            given = second if first == "--realtime" else first.removeprefix("--realtime=")
            if given != first and re.match(r"-[.\d]", given):
                factor(given)
        return super().parse_args(ctx, args)


def scenario_arguments(*names: str) -> Callable[[Any], Any]:
    """Adds the arguments a scenario is made of; all of them, or those named."""

    def decorate(command: Any) -> Any:
        for name in reversed(names or tuple(_OF_A_SCENARIO)):
            command = _OF_A_SCENARIO[name](command)
        return command

    return decorate


_TOLD = (
    click.option(
        "--metrics",
        envvar="MEANFLOCK_METRICS",
        metavar="[HOST:]PORT",
        help="Where Prometheus can read the run; 0 for any free port.",
    ),
    click.option(
        "--log-format",
        type=click.Choice((logs.TEXT, logs.JSON)),
        envvar="MEANFLOCK_LOG_FORMAT",
        help="Pass on the logs of all processes, on stderr; with json it has nothing else.",
    ),
    click.option("--json", "as_json", is_flag=True, help="Print the summary as one JSON object, nothing else."),
    click.option("--quiet", is_flag=True, help="No progress bar."),
)


def _telling(command: Any) -> Any:
    """Adds what a flight tells, and to whom."""
    for option in reversed(_TOLD):
        command = option(command)
    return command


@cli.command(cls=_Run)
@scenario_arguments()
@click.option("--in-process", is_flag=True, help="All nodes in this process, without the network.")
@click.option("--uavs-per-process", type=click.IntRange(1), default=1, show_default=True, metavar="M")
@click.option(
    "--realtime",
    is_flag=False,
    flag_value="1",
    metavar="[FACTOR]",
    help="Ticks follow the wall clock, FACTOR (default 1) times faster; late commands are held.",
)
@click.option("--faults", type=click.Path(path_type=Path), metavar="FILE", help="A fault script: [[faults]] in TOML.")
@click.option("--record/--no-record", default=True, show_default=True, help="Write recording.rrd.")
@click.option("--view", is_flag=True, help="Stream live to a Rerun viewer.")
@click.option("--out", type=click.Path(path_type=Path), default=Path("runs"), show_default=True, metavar="DIR")
@click.option(
    "--endpoint",
    metavar="ADDRESS",
    help="Where the world listens, e.g. tcp/127.0.0.1:7447. [default: a free port]",
)
@click.option("--tls", type=click.Path(path_type=Path), metavar="DIR", help="Mutual TLS; see `meanflock certs init`.")
@_telling
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
    """Fly a scenario, by default the paper's.

    It leaves OUT/<id>/ with summary, time series, events and recording.

    \b
    Example: meanflock run --method hjb --uavs 9 --seed 3 --set wind.sigma=0.2
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


@cli.command()
@click.argument("folder", metavar="RUN", type=click.Path(path_type=Path))
@scenario_arguments("plugin")
@click.option("--in-process", is_flag=True, help="All nodes in this process, without the network.")
@click.option("--uavs-per-process", type=click.IntRange(1), default=1, show_default=True, metavar="M")
@click.option("--tls", type=click.Path(path_type=Path), metavar="DIR", help="Mutual TLS; see `meanflock certs init`.")
@click.option("--record/--no-record", default=True, show_default=True, help="Go on with recording.rrd.")
@_telling
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
    """Go on with a run that did not finish.

    From its last checkpoint, to the end it would have had.

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
        logs.tell(f"run folder {done.folder}")


@cli.command()
@click.option("--uavs", type=click.IntRange(1), default=25, show_default=True, metavar="N")
@click.option("--uavs-per-process", type=click.IntRange(1), default=1, show_default=True, metavar="M")
@click.option("--out", type=click.Path(path_type=Path), default=Path("runs"), show_default=True, metavar="DIR")
@click.option("--tls", type=click.Path(path_type=Path), metavar="DIR", help="Also look at these certificates.")
def doctor(uavs: int, uavs_per_process: int, out: Path, tls: Path | None) -> None:
    """Say what would fail here before it does.

    What this machine has, beside what a run of N UAVs needs. Exit code 1 if anything would fail.

    \b
    Example: meanflock doctor --uavs 64
    """
    findings = checks.examine(uavs, uavs_per_process, out, tls)
    table = Table("what", "verdict", "found", "mend", title=f"meanflock {__version__}")
    colours = {"ok": "green", "warning": "yellow", "fails": "red"}
    for finding in findings:
        colour = colours[finding.verdict]
        table.add_row(finding.what, f"[{colour}]{finding.verdict}[/]", finding.found, finding.mend)
    Console().print(table)
    if any(finding.verdict == "fails" for finding in findings):
        raise SystemExit(EXIT_RUN_FAILED)


@cli.group("certs")
def certs_group() -> None:
    """Make certificates: who is who on the network. See docs/security.md."""


@certs_group.command("init")
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.option("--uavs", type=click.IntRange(1, 10_000), default=25, show_default=True, metavar="N")
@click.option("--days", type=click.IntRange(1, 3650), default=90, show_default=True, help="They expire after that.")
@click.option("--host", "hosts", multiple=True, metavar="NAME", help="Another name or address of the world's machine.")
def certs_init(folder: Path, uavs: int, days: int, hosts: tuple[str, ...]) -> None:
    """Make DIR with an authority and one certificate each for the world, leader, station and N agents.

    \b
    Example: meanflock certs init out/certs --uavs 4
    """
    from meanflock.groundstation import certs

    written = certs.init(folder, uavs, days, hosts)
    click.echo(
        f"{folder}: {len(written)} files, valid for {days} days; keep the keys, and above all ca.key, to yourself"
    )


@cli.group("scenario")
def scenario_group() -> None:
    """Look at scenarios."""


@scenario_group.command()
@scenario_arguments()
def show(
    file: Path | None,
    method: str | None,
    uavs: int | None,
    seed: int | None,
    duration: float | None,
    settings: tuple[str, ...],
) -> None:
    """Print a scenario, resolved, as TOML that can be flown again.

    \b
    Example: meanflock scenario show --method hjb > my.toml
    """
    click.echo(to_toml(scenario.load(file, settings, method=method, uavs=uavs, seed=seed, duration=duration)), nl=False)


@scenario_group.command()
@scenario_arguments("method", "plugin")
def schema(method: str | None) -> None:
    """Print the JSON schema of scenario files: every key with its unit and bounds, and the options of a controller.

    \b
    Example: meanflock scenario schema --method mfgfl-hf
    """
    click.echo(json.dumps(catalogue.schema(method), indent=1))


def _refuse_if_too_large(flown: scenario.Scenario, uavs_per_process: int) -> None:
    """A swarm that does not fit into memory is refused before it starts; 0 UAVs per process: all in this one."""
    processes = -(-flown.uavs // uavs_per_process) if uavs_per_process else 0
    needs = [checks.memory(flown.uavs, processes, flown.declared.pairwise)]
    needs += [checks.open_files(flown.uavs, uavs_per_process)] if processes else []
    for finding in needs:
        if finding.verdict == "fails":
            raise BadInput(f"{finding.what}: {finding.found}; {finding.mend}")


def main(arguments: list[str] | None = None) -> int:
    """The `meanflock` command: every error is one line and an exit code."""
    from meanflock.groundstation import cli_look, cli_plugins, cli_study  # noqa: F401  # their verbs join the group

    if arguments is None:
        os.environ["PYTHONSAFEPATH"] = "1"  # no worker of a sweep runs what lies in the working folder under our names
        divert()  # standard output is what we say; what libraries say in native code is not
    try:
        cli.main(arguments, prog_name="meanflock", standalone_mode=False)
        code = EXIT_DONE
    except MeanflockError as error:
        logs.tell(f"error: {error}", logging.ERROR)
        code = error.exit_code
    except click.ClickException as error:
        place = error.ctx.command_path if isinstance(error, click.UsageError) and error.ctx else "meanflock"
        click.echo(f"error: {error.format_message()} See `{place} --help`.", err=True)
        code = EXIT_BAD_INPUT
    except click.Abort:
        code = EXIT_RUN_FAILED
    except SystemExit as leaving:
        code = leaving.code if isinstance(leaving.code, int) else EXIT_RUN_FAILED
    finally:
        logs.stop()
    if arguments is None:
        sys.exit(code)
    return code


if __name__ == "__main__":
    from meanflock.groundstation import cli as installed  # the verbs join that module's group, not this one's

    installed.main()
