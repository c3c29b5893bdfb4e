"""Copy of the file that a run's vehicle reads, in the folder of the run; a resumed run reads it there."""

import hashlib
from pathlib import Path

from meanflock.swarm import durable, paths
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario

FOLDER = "vehicle"


def content(flown: Scenario) -> bytes | None:
    """Content of the file with the starts of a planned scenario; None if there is none.

    Raises:
        BadInput: the file cannot be read, or has changed since the flight was planned.
    """
    if flown.vehicle.file is None or not (recorded := flown.vehicle.options.get("sha256")):
        return None
    path = paths.given(flown.vehicle.file)
    try:
        found = paths.read(path, paths.LOG_BYTES)
    except OSError as error:
        raise BadInput(f"{path}: {error.strerror}; bring the file back, the run folder gets a copy of it") from error
    if hashlib.sha256(found).hexdigest() != recorded:
        raise BadInput(f"{path}: was changed since it was read; start again")
    return found


def keep(folder: Path, flown: Scenario, found: bytes) -> str:
    """Write the content to the folder of a run; returns the name of the copy in it. Raises OSError."""
    copy = _copy(folder, flown)
    copy.parent.mkdir(exist_ok=True)
    durable.replace(copy, found)
    return str(copy.relative_to(folder))


def from_copy(folder: Path, flown: Scenario) -> Scenario:
    """The scenario of a run, whose vehicle reads the copy if there is one."""
    if flown.vehicle.file is None or not (copy := _copy(folder, flown)).exists():
        return flown
    return flown.replace(**{"vehicle.options.file": str(copy)})


def _copy(folder: Path, flown: Scenario) -> Path:
    return folder / FOLDER / Path(str(flown.vehicle.file)).name
