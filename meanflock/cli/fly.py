"""Commands that fly: run, resume."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from meanflock.cli.arguments import (
    PATH,
    in_process_option,
    out_option,
    scenario_arguments,
    telling,
    tls_option,
    uavs_per_process_option,
    unfinished_run_argument,
)

if TYPE_CHECKING:
    from meanflock.launch.forking import Forker


class _RunCommand(click.Command):
    """Command `run`, with an error of our own for a negative `--realtime`, which Click takes for a flag."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Check `--realtime`, then parse as usual."""
        for first, second in pairwise([*args, ""]):
            given = second if first == "--realtime" else first.removeprefix("--realtime=")
            if given != first and re.match(r"-[.\d]", given) and not ctx.resilient_parsing:
                from meanflock.worldsim.clocks import factor

                factor(given)
        return super().parse_args(ctx, args)


@click.command(cls=_RunCommand)
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
    "--steer",
    metavar="[HOST:]PORT",
    help="With --realtime: let MAVLink clients steer UAVs, by UDP; port 0: any free one.",
)
@click.option("--faults", type=PATH, metavar="FILE", help="Inject the faults of this script (TOML).")
@click.option(
    "--record/--no-record",
    default=None,
    help="Write recording.rrd for the Rerun viewer.  [default: --record, if Rerun is installed]",
)
@click.option("--view", is_flag=True, help="Watch live in the Rerun viewer; needs a display.")
@click.option("--web", is_flag=True, help="With --view: watch in a browser, at the address printed; needs no display.")
@out_option("runs", "Where run folders are made.")
@click.option(
    "--endpoint",
    metavar="ADDRESS",
    help="Where the world listens, e.g. tcp/127.0.0.1:7447; port 0: any free one.  [default: tcp/127.0.0.1:0]",
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
    **given: Any,
) -> None:
    """Fly a scenario once, by default the paper's.

    SCENARIO is a TOML file, or the name of one that comes with meanflock:

    \b
    crowd, faults, groups, gusts, hierarchical, lossy, massive, obstacles,
    paper, paper-exchanged, paper-printed, paper-slow, patrol, radio-mast,
    radio-sky, radio-street, radio-thin, streams, swap, unknown, windmap,
    windy.

    \b
    In space: layers, mast, sphere, tower. The others fly there, too, with
    --set space.dimensions=3.

    Results are written to OUT/<id>/: summary, time series, events, recording.

    \b
    Example: meanflock run --method hjb --uavs 9 --set wind.sigma=0.2
    """
    keys = {"method": method, "uavs": uavs, "seed": seed, "duration": duration}
    with _forker(in_process) as forker:
        from meanflock.cli import flight  # its libraries are loaded while the forker loads others

        flight.run(file, settings, keys=keys, in_process=in_process, forker=forker, **given)


@click.command()
@unfinished_run_argument
@scenario_arguments("plugin")
@in_process_option
@uavs_per_process_option
@tls_option
@click.option(
    "--record/--no-record",
    default=None,
    help="Continue recording.rrd.  [default: --record, if Rerun is installed]",
)
@telling
def resume(folder: Path, as_json: bool, in_process: bool, **given: Any) -> None:
    """Resume a run that did not finish, from its last checkpoint.

    RUN is its folder, or `latest`: the last one in `runs` that can be resumed. The result is the same as without the
    interruption.

    \b
    Example: meanflock resume runs/20261121-101500-mfgfl-hf-s7
    """
    with _forker(in_process) as forker:
        from meanflock.cli import flight

        flight.resume(folder, as_json, in_process=in_process, forker=forker, **given)


@contextmanager
def _forker(in_process: bool) -> "Iterator[Forker | None]":
    """Context of the process that forks the others; None where there are none, or where a fork is not safe."""
    if in_process:
        yield None
        return
    from meanflock.launch.forking import Forker
    from meanflock.launch.forks import SAFE

    if not SAFE:
        yield None
        return
    with Forker() as forker:
        yield forker
