"""The command that lists what is installed: plugins."""

import json
import shutil
import sys
from contextlib import redirect_stdout

import click

from meanflock.groundstation.cli.arguments import scenario_arguments

_NARROW, _WIDE = 80, 110  # columns


@click.command("plugins")
@scenario_arguments("plugin")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON array on stdout.")
def plugins_command(as_json: bool) -> None:
    """List controllers and all other plug-ins, with their options.

    The other kinds are aggregation rules, channels, vehicles and filters. Each has its name, the package or file it
    comes from, a description, and the options that a scenario can set.

    \b
    Example: meanflock plugins --plugin mine.py
    """
    from meanflock.groundstation.catalogue import catalogue, records, text

    with redirect_stdout(sys.stderr):  # packages that are imported for it may print
        entries = catalogue()
    if as_json:
        click.echo(json.dumps(records(entries), indent=1))
        return
    columns = shutil.get_terminal_size((_NARROW, 24)).columns
    click.echo(text(entries, min(max(columns, _NARROW), _WIDE)))
