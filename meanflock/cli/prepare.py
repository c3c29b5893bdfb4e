"""Commands to prepare a flight: doctor, certs, plugins, scenario."""

import json
import shutil
import sys
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import click

from meanflock.cli.arguments import (
    PATH,
    CommandGroup,
    load_scenario,
    number_option,
    out_option,
    scenario_arguments,
    uavs_per_process_option,
)
from meanflock.swarm import __version__
from meanflock.swarm.errors import EXIT_RUN_FAILED


@click.command()
@scenario_arguments()
@uavs_per_process_option
@out_option("runs", "Where run folders would be made.")
@click.option("--tls", type=PATH, metavar="DIR", help="Check the certificates in DIR too.")
def doctor(
    file: Path | None, settings: tuple[str, ...], uavs_per_process: int, out: Path, tls: Path | None, **options: Any
) -> None:
    """Check whether a run would work on this machine.

    SCENARIO is a TOML file, or the name of one that comes with meanflock; by default the paper's. The check also says
    what share of the models that UAVs send will be lost. Every finding that is not ok says what to do. The exit code is
    1 if anything would fail.

    \b
    Example: meanflock doctor --uavs 64
    """
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from meanflock.launch import doctor as checks

    findings = checks.examine(load_scenario(file, settings, **options), uavs_per_process, out, tls)
    table = Table(title=f"meanflock {__version__}")
    for heading in ("what", "verdict", "found", "what to do"):
        table.add_column(heading, overflow="fold", no_wrap=heading in ("what", "verdict"))
    colours = {"ok": "green", "warning": "yellow", "fails": "red"}
    for finding in findings:
        colour = colours[finding.verdict]
        table.add_row(finding.check, f"[{colour}]{finding.verdict}[/]", escape(finding.found), escape(finding.remedy))
    Console().print(table)
    if any(finding.verdict == "fails" for finding in findings):
        raise SystemExit(EXIT_RUN_FAILED)


@click.group("certs", cls=CommandGroup)
def certs_group() -> None:
    """Make TLS certificates for the nodes of a swarm.

    \b
    Example: meanflock certs init out/certs --uavs 4
    """


@certs_group.command("init")
@click.argument("folder", metavar="DIR", type=PATH)
@number_option("--uavs", "N", 25, "Number of agents.", most=10_000)
@number_option("--days", "DAYS", 90, "Days until they expire.", most=3650)
@click.option(
    "--host", "hosts", multiple=True, metavar="NAME", help="Another name or address of the world's machine; repeatable."
)
def certs_init(folder: Path, uavs: int, days: int, hosts: tuple[str, ...]) -> None:
    """Make a certificate for every node, in the new folder DIR.

    That is a certificate authority, and one certificate each for the world, the leader, the ground station, an
    observer and N agents. What TLS protects: docs/security.md.

    \b
    Example: meanflock certs init out/certs --uavs 4
    """
    from meanflock.launch import certs

    written = certs.init(folder, uavs, days, hosts)
    click.echo(
        f"{folder}: {len(written)} files, valid for {days} days; keep the keys, and above all ca.key, to yourself"
    )


@click.group("scenario", cls=CommandGroup)
def scenario_group() -> None:
    """Print a scenario, or the schema of scenario files.

    \b
    Example: meanflock scenario show paper > my.toml
    """


@scenario_group.command()
@scenario_arguments()
def show(file: Path | None, settings: tuple[str, ...], **options: Any) -> None:
    """Print a scenario as TOML, with the value of every key.

    The output is a scenario file that `meanflock run` accepts. Comments at its head say what its radio can do.

    \b
    Example: meanflock scenario show --method hjb > my.toml
    """
    from meanflock.channel.remarks import remarks
    from meanflock.results.run_folder import to_toml

    flown = load_scenario(file, settings, **options)
    for line in remarks(flown):
        click.echo(f"# {line}")
    click.echo(to_toml(flown), nl=False)


@scenario_group.command()
@scenario_arguments("method", "plugin")
def schema(method: str | None) -> None:
    """Print the JSON schema of scenario files.

    It has the unit and the bounds of every key and, with --method, the options of that controller.

    \b
    Example: meanflock scenario schema --method mfgfl-hf
    """
    from meanflock.cli import catalogue

    click.echo(json.dumps(catalogue.schema(method), indent=1))


_NARROW, _WIDE = 80, 110  # columns


@click.command("plugins")
@scenario_arguments("plugin")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON array on stdout.")
def plugins_command(as_json: bool) -> None:
    """List controllers and all other plug-ins, with their options.

    The other kinds are aggregation rules, topologies, channels, vehicles, learners, filters and codings. Each has its
    name, the package or file it comes from, a description, and the options that a scenario can set.

    \b
    Example: meanflock plugins --plugin mine.py
    """
    from meanflock.cli.catalogue import catalogue, records, text

    with redirect_stdout(sys.stderr):  # imported packages may print
        entries = catalogue()
    if as_json:
        click.echo(json.dumps(records(entries), indent=1))
        return
    columns = shutil.get_terminal_size((_NARROW, 24)).columns
    click.echo(text(entries, min(max(columns, _NARROW), _WIDE)))
