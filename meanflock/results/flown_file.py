"""Copies of the files that vehicles read, in the folder of a run or of a study; what flies again reads them there."""

import hashlib
from collections.abc import Iterator, Mapping
from pathlib import Path

from meanflock.swarm import durable, paths
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario, VehicleTable

FOLDER = "vehicle"
_DIGITS = 8  # of a hash that names a folder


def contents(flown: Scenario, of_study: bool = False) -> dict[str, bytes]:
    """Contents of the files that the vehicles of a planned scenario read, by the place of each copy in the folder.

    `of_study`: whether the folder has copies for several scenarios, so that the names of copies tell the content.

    Raises:
        BadInput: a file cannot be read, or has changed since the flight was planned.
    """
    return {
        str(copy): _content(vehicle) for _, vehicle, copy in _copies(flown, of_study) if vehicle.options.get("sha256")
    }


def keep(folder: Path, found: Mapping[str, bytes]) -> None:
    """Write the contents to the folder of a run. Raises OSError."""
    for copy, content in found.items():
        (folder / copy).parent.mkdir(parents=True, exist_ok=True)
        durable.replace(folder / copy, content)


def from_copies(folder: Path, flown: Scenario, of_study: bool = False) -> Scenario:
    """The scenario of a run, or of a study, whose vehicles read the copies that are there."""
    copies = {key: folder / copy for key, _, copy in _copies(flown, of_study)}
    keys = {f"{key}.options.file": str(copy) for key, copy in copies.items() if copy.exists()}
    return flown.replace(**keys) if keys else flown


def _copies(flown: Scenario, of_study: bool) -> Iterator[tuple[str, VehicleTable, Path]]:
    """Key, table and place of the copy in the folder of a run or of a study, of each vehicle that reads a file."""
    own = ((f"groups.{group.name}.vehicle", group.vehicle, Path(FOLDER, group.name)) for group in flown.groups)
    for key, vehicle, folder in (("vehicle", flown.vehicle, Path(FOLDER)), *own):
        if vehicle is not None and vehicle.file is not None:
            place = Path(FOLDER, str(vehicle.options.get("sha256"))[:_DIGITS]) if of_study else folder
            yield key, vehicle, place / Path(vehicle.file).name


def _content(vehicle: VehicleTable) -> bytes:
    path = paths.given(str(vehicle.file))
    try:
        found = paths.read(path, paths.LOG_BYTES)
    except OSError as error:
        raise BadInput(
            f"{path}: {error.strerror}; bring the file back, the folder of results gets a copy of it"
        ) from error
    if hashlib.sha256(found).hexdigest() != vehicle.options["sha256"]:
        raise BadInput(f"{path}: was changed since it was read; start again")
    return found
