"""The command that writes a run in the files of other tools."""

from pathlib import Path
from typing import Any

import click

from meanflock.cli.arguments import PATH, quiet_option, report, run_argument, scenario_arguments
from meanflock.cli.study_arguments import progress_of
from meanflock.swarm import logs
from meanflock.swarm.durable import writable
from meanflock.swarm.errors import BadInput, needed


@click.command()
@run_argument
@click.option("--mcap", type=PATH, metavar="FILE.mcap", help="Write an MCAP file, which Foxglove and ROS 2 open.")
@click.option("--rosbag", type=PATH, metavar="DIR", help="Write the same as a bag of ROS 2, which is a new folder.")
@click.option("--radio", type=PATH, metavar="FILE.json", help="Write what became of every upload, to be replayed.")
@click.option(
    "--take-off",
    metavar="TIME",
    help="When the UAVs took off, e.g. 2026-11-21T10:15:00Z, or `run`: when the run began.  [default: 0 s]",
)
@scenario_arguments("plugin")
@quiet_option
def export(
    folder: Path, mcap: Path | None, rosbag: Path | None, radio: Path | None, take_off: str | None, quiet: bool
) -> None:
    """Write a run for Foxglove and ROS 2, or its radio as a table.

    RUN is its folder, or `latest`. Foxglove and ROS 2 need the extra `export`. The table of `--radio` has a row for
    each upload: round, UAV, share that arrived, delay and bits; examples/flower_radio.py replays it in Flower.

    \b
    Example:
      meanflock export runs/20261121-101500-mfgfl-hf-s7 --mcap swarm.mcap
    """
    from meanflock.export import instants
    from meanflock.results.flown import FlightSoFar
    from meanflock.results.run_folder import alone, completed

    if mcap is None and rosbag is None and radio is None:
        raise BadInput("export: name what to write: --mcap FILE.mcap, --rosbag DIR or --radio FILE.json")
    writers: list[tuple[str, Path, Any]] = []
    if radio is not None:
        from meanflock.export.radio import write_radio

        writers.append(("--radio", radio, write_radio))
    if mcap is not None or rosbag is not None:
        with needed("`meanflock export`", "export"):
            from meanflock.export.bag import write_bag, write_mcap
        wanted = (("--mcap", mcap, write_mcap), ("--rosbag", rosbag, write_bag))
        writers += [(flag, path, write) for flag, path, write in wanted if path is not None]
    for flag, path, _ in writers:
        if path.exists():
            raise BadInput(f"{flag} {path}: there is something already; remove it, or give another name")
    if len({path for _, path, _ in writers}) < len(writers):
        raise BadInput(f"export: {writers[-1][1]} is named twice; give each file a name of its own")
    if not folder.is_dir():
        raise BadInput(f"{folder}: no such run; name the folder of one")
    take_off_ns = 0 if take_off is None else instants.take_off(take_off, folder)
    with alone(folder):
        completed(folder)
    flight = FlightSoFar(folder, take_off_ns)
    if not flight.finished:
        logs.show(f"{folder}: the run did not finish; this is the flight up to tick {flight.ticks - 1}")
    if (mcap or rosbag) and flight.scenario.uavs > instants.MOST_UAVS:
        logs.show(
            f"{flight.scenario.uavs} UAVs: frames, markers and diagnostics are those of {instants.MOST_UAVS}, evenly "
            "chosen; /series/ has all"
        )
    for flag, path, write in writers:
        with writable(flag, path):
            path.parent.mkdir(parents=True, exist_ok=True)
        with progress_of(f"writing {flag[2:]}", quiet, "ticks") as show:
            write(flight, path, show)
        report([path])
