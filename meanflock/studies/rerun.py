"""Flies a study again from its study.json, and says which flights differ."""

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq

from meanflock.results import flown_file, flown_plugins
from meanflock.studies import study
from meanflock.studies.flight_table import FLIGHTS, flight_table
from meanflock.studies.runner import Jobs
from meanflock.studies.store import Store
from meanflock.studies.study_file import (
    StudyRecord,
    flight_records,
    plugins_that_fly,
    read,
    reproducible,
    sha256_of,
)
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario

Point = tuple[Any, ...]
RERUN = "rerun"  # folder beside study.json for flights of an interrupted rerun


class FlightDifference(NamedTuple):
    """A field of a flight that is not the same again; None: unknown."""

    point: Point
    seed: int
    field: str
    expected: Any
    found: Any


class Study:
    """A study that can fly again: its record, the scenarios of its flights, and their rows, if the table is there."""

    def __init__(self, file: Path) -> None:
        """
        Raises:
            BadInput: the record, a table beside it, or a plug-in is not the one that the study had.
        """
        self.record: StudyRecord = read(file)
        for name, was in self.record.files.items():
            if (table := file.parent / name).exists() and sha256_of(table) != was:
                raise BadInput(
                    f"{table}: not the table of the study: its SHA-256 differs from that in {file}; restore it"
                )
        try:
            scenarios = self.record.scenarios()
        except BadInput as error:
            raise BadInput(f"{file}: {error}") from error
        self.scenarios = {point: _from_copies(file.parent, flights) for point, flights in scenarios.items()}
        try:
            here = plugins_that_fly(self.scenarios)
        except BadInput as error:
            copies = _copies(file.parent)
            raise BadInput(f"{file}: {str(error).partition(';')[0] if copies else error}{copies}") from error
        for flew, found in zip(self.record.plugins, here, strict=True):
            if flew != found:
                raise BadInput(
                    f"{file}: it flew {flew[0]} {flew[1]!r} of {flew[2]}; here it is of {found[2]}"
                    + (_copies(file.parent) or "; install that version")
                )
        path = file.parent / FLIGHTS
        self._expected: pa.Table | None = pq.read_table(path) if path.exists() else None

    def fly(self, jobs: Jobs, progress: Callable[[int, int], None], store: Store) -> list[FlightDifference]:
        """Fly all flights that `store` does not have, and compare them; the store is then deleted.

        Raises:
            RunFailed: as for `fly_all`; the same call flies the rest.
        """
        flown = study.fly_all(self.scenarios, jobs, progress, store)
        differences = list(self._differences(flown))
        shutil.rmtree(store.data)
        with suppress(OSError):  # other files are in the folder
            store.data.parent.rmdir()
        return differences

    @property
    def flights(self) -> int:
        """Number of flights."""
        return sum(map(len, self.scenarios.values()))

    def _differences(self, flown: Mapping[Point, Sequence[Mapping[str, Any]]]) -> Iterator[FlightDifference]:
        names = self.record.names
        rows = iter(reproducible(self._expected)) if self._expected is not None else None
        for point, values in zip(self.record.points, self.scenarios, strict=True):
            found = flight_records(names, values, flown[values])
            again = reproducible(flight_table(names, {values: flown[values]}))
            for was, now, row in zip(point.flights, found, again, strict=True):
                before = next(rows) if rows is not None else {}
                for field in was.__struct_fields__:
                    if getattr(was, field) != getattr(now, field) and not (before and field == "summary_sha256"):
                        yield FlightDifference(values, was.seed, field, getattr(was, field), getattr(now, field))
                for field in dict.fromkeys((*before, *row)) if before else ():
                    if before.get(field) != row.get(field) and field not in was.__struct_fields__:
                        yield FlightDifference(values, was.seed, field, before.get(field), row.get(field))


def _from_copies(out: Path, flights: Sequence[Scenario]) -> list[Scenario]:
    """The flights of a point, whose vehicles read the copies of files in the folder of the study."""
    first = flown_file.from_copies(out, flights[0], of_study=True)
    return [msgspec.structs.replace(first, seed=flown.seed) for flown in flights]


def _copies(out: Path) -> str:
    """Advice to load the copies of plug-ins in the folder of a study; empty if there are none."""
    copies = "".join(f" --plugin {path}" for path in sorted((out / flown_plugins.FOLDER).glob("*.py")))
    return f"; read the copies of what flew, and name them:{copies}" if copies else ""
