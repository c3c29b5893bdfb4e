"""The command `new`: a package for a plug-in of one's own."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from meanflock.cli.arguments import report

if TYPE_CHECKING:
    from meanflock.cli.scaffold import Kind

_KINDS = ("controller", "aggregator", "channel", "vehicle", "learner", "filter", "coding")


@click.command()
@click.argument("kind", type=click.Choice(_KINDS), metavar="KIND")
@click.argument("name", metavar="NAME")
def new(kind: "Kind", name: str) -> None:
    """Write a package for your own controller or other plug-in.

    KIND is controller, aggregator, channel, vehicle, learner, filter or coding. NAME is the name of the plug-in and of
    its folder in the working folder. The package has a small source file that flies as it is, an entry point by which
    meanflock finds it, a conformance test, and a workflow for GitHub that runs the test.

    \b
    Example: meanflock new controller swirl
    """
    from meanflock.cli import scaffold

    report(scaffold.create(kind, name, Path()))
    click.echo(
        f"\nNext: pip install -e './{name}[test]'\n      python -m pytest {name}\n      {scaffold.flight(kind, name)}"
    )
