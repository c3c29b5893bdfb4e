"""Commands that show a flight to other software while it is flown or played."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from meanflock.cli import completion
from meanflock.cli.arguments import PATH, RUN, CommandGroup, Positive
from meanflock.swarm import logs
from meanflock.swarm.errors import BadInput, needed

if TYPE_CHECKING:
    from meanflock.bridge.mavlink import Base
    from meanflock.results.flown import FlownKeys

_HOME = "47.397742,8.545594,488"  # where autopilots are simulated by default
_TO = "127.0.0.1:14550"  # where ground stations listen


@click.group(cls=CommandGroup)
def bridge() -> None:
    """Show a flight to other software, live or from a run folder.

    \b
    Example: meanflock bridge mavlink runs/20261121-101500-mfgfl-hf-s7
    """


@bridge.command()
@click.argument("folder", metavar="[RUN]", required=False, type=RUN, shell_complete=completion.runs)
@click.option("--live", metavar="ENDPOINT", help="Show the flight of the world there, e.g. tcp/127.0.0.1:7447.")
@click.option("--tls", type=PATH, metavar="DIR", help="With --live: use the observer's certificate in DIR.")
@click.option(
    "--wait",
    type=Positive(),
    default=60.0,
    show_default=True,
    metavar="SECONDS",
    help="With --live: how long to wait for the flight.",
)
@click.option(
    "--speed",
    type=Positive(above=True),
    metavar="FACTOR",
    help="Play a run so many times faster.  [default: 1]",
)
@click.option(
    "--to",
    multiple=True,
    default=[_TO],
    show_default=True,
    metavar="[HOST:]PORT",
    help="Where to send the messages, by UDP; repeatable.",
)
@click.option(
    "--home",
    default=_HOME,
    show_default=True,
    metavar="LAT,LON[,ALT]",
    help="Place of the scenario's origin: degrees, and metres above sea level.",
)
def mavlink(
    folder: Path | None,
    live: str | None,
    tls: Path | None,
    wait: float,
    speed: float | None,
    to: tuple[str, ...],
    home: str,
) -> None:
    """Show each UAV as a MAVLink vehicle, in real time.

    RUN is the folder of a run, or `latest`; --live shows a flight while it is flown. UAV k is system k + 1 and sends
    HEARTBEAT, LOCAL_POSITION_NED and GLOBAL_POSITION_INT; the first station of the
    scenario is its home. Needs the extra `mavlink`.

    \b
    Example: meanflock bridge mavlink runs/20261121-101500-mfgfl-hf-s7 --speed 4
    """
    with needed("`meanflock bridge mavlink`", "mavlink"):
        from meanflock.bridge.mavlink import Home
        from meanflock.bridge.vehicles import Vehicles, play
    from meanflock.net.access import Address
    from meanflock.results.flown import FlightSoFar

    if (folder is None) == (live is None):
        raise BadInput("bridge mavlink: name the folder of a run, or --live ENDPOINT")
    addresses = [Address.parse("--to", text) for text in to]
    where = Home.parse(home)

    def say(vehicles: Vehicles, uavs: int) -> None:
        more = f"; MAVLink has no more system ids, so UAVs {vehicles.count} to {uavs - 1} are not shown"
        logs.show(
            f"systems 1 to {vehicles.count}, by UDP to {', '.join(map(str, addresses))}{more * (uavs > vehicles.count)}"
        )

    if folder is not None:
        if tls is not None:
            raise BadInput(f"--tls {tls}: a recorded run has no links; leave it out, or give --live")
        flight = FlightSoFar(folder)
        flown = flight.scenario
        with Vehicles(flown.uavs, flown.dt, addresses, where, base=_base(flown)) as vehicles:
            say(vehicles, flown.uavs)
            play(flight, vehicles, speed or 1.0)
        return
    if speed is not None:
        raise BadInput(f"--speed {speed:g}: a live flight has its own; leave it out, or name the folder of a run")
    from meanflock.bridge.observer import Observer, open_bus

    assert live is not None
    bus = open_bus(live, wait, tls)
    try:
        observer = Observer(bus, wait)
        flown = observer.scenario
        with Vehicles(flown.uavs, flown.dt, addresses, where, base=_base(flown)) as vehicles:
            say(vehicles, flown.uavs)
            observer.listen(vehicles)
    finally:
        bus.close()


def _base(flown: "FlownKeys") -> "Base | None":
    """The place of the first station, if there is any."""
    return flown.stations[0].place if flown.stations else None
