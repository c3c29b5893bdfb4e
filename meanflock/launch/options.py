"""Options of a flight."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from meanflock.net.access import Address
from meanflock.swarm import logs
from meanflock.swarm.errors import BadInput

if TYPE_CHECKING:
    from meanflock.launch.forking import Forker


@dataclass(frozen=True)
class FlightOptions:
    """Options of a flight; they do not change the trajectory."""

    out: Path
    in_process: bool = False
    uavs_per_process: int = 1
    realtime: float | None = None
    steer: Address | None = None  # where MAVLink clients steer UAVs
    record: bool = True
    serve: tuple[str, int] | None = None  # where a live viewer connects
    endpoint: str | None = None
    tls: Path | None = None  # folder of certificates
    quiet: bool = False
    watch: Callable[[str], object] | None = None  # called with the URL of the live recording before take-off
    metrics: Address | None = None  # where Prometheus can read the run
    forker: "Forker | None" = None  # from which processes are forked; None: they are started one by one
    mission: str | None = None  # name of the scenario, if it has one
    log_format: str | None = None  # form of all processes' output on standard error; None: warnings only


_ABSENT = "rerun is not installed"
_REMEDY = "pip install 'meanflock[ground]'"


def records(wanted: bool | None, option: str, quiet: bool) -> bool:
    """Decide whether a flight writes a recording. Without Rerun it writes none, and unless `quiet` a line says so.

    Args:
        wanted: whether the user asks for a recording; None: the user did not say. option: how the user asks.

    Raises:
        BadInput: the user asks for a recording, and Rerun is not installed.
    """
    if wanted is False:
        return False
    if find_spec("rerun") is not None:
        return True
    if wanted:
        raise BadInput(f"{_ABSENT}, and {option} needs it: {_REMEDY}")
    if not quiet:
        logs.show(f"no recording.rrd is written: {_ABSENT}; {_REMEDY}")
    return False
