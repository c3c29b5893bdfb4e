"""study.json: what a study flew, with the versions and the hashes by which others can fly it again."""

import hashlib
import json
import platform
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa

from meanflock import kernels
from meanflock.federation.plan import plugins_of
from meanflock.results.quantities import VARYING
from meanflock.results.scenario_keys import flat
from meanflock.studies.each_round import EACH_ROUND
from meanflock.studies.flight_table import TABLES, Points, flight_table
from meanflock.studies.job_file import version
from meanflock.swarm import __version__, durable, paths, toml
from meanflock.swarm.errors import BadInput
from meanflock.swarm.provenance import commit
from meanflock.swarm.scenario import Scenario, as_builtins
from meanflock.swarm.scenario.values import validated

STUDY_FILE = "study.json"
SCHEMA = 1
Point = tuple[Any, ...]


class FlightRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Hashes of a flight: of its scenario, its trajectory, its reproducible numbers, and its rounds."""

    seed: int
    scenario_sha256: str
    trajectory_sha256: str
    summary_sha256: str
    rounds_sha256: str


class PointRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A point: its varied values, the keys of its scenario that not all points share, and its flights."""

    values: list[Any]
    keys: dict[str, Any]
    flights: list[FlightRecord]


class StudyRecord(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A study. names: of the varied values. keys: of the resolved scenarios, as far as all points share them.

    plugins: kind, name, and version of the package or hash of the file. files: their SHA-256.
    """

    schema: int
    command: str
    meanflock: str
    code: str
    commit: str | None
    python: str
    numpy: str
    machine: str
    kernels: str
    plugins: list[tuple[str, str, str]]
    names: list[str]
    keys: dict[str, Any]
    points: list[PointRecord]
    files: dict[str, str]

    def scenarios(self) -> dict[Point, list[Scenario]]:
        """The scenarios of all flights, by the values of their point.

        Raises:
            BadInput: one is invalid, or not the one that flew.
        """
        found: dict[Point, list[Scenario]] = {}
        for point in self.points:
            table: dict[str, Any] = {}
            for key, value in (self.keys | point.keys).items():
                toml.put(table, key, value)
            first = validated(table, Scenario, STUDY_FILE)
            flights = [msgspec.structs.replace(first, seed=flight.seed) for flight in point.flights]
            for flight, flown in zip(point.flights, flights, strict=True):
                if flown.sha256() != flight.scenario_sha256:
                    raise BadInput(
                        f"point {point.values}, seed {flight.seed}: the keys give another hash of the scenario than "
                        "the record has; restore the file"
                    )
            found[_hashable(point.values)] = flights
        return found

    @property
    def versions(self) -> dict[str, str]:
        """What flew, apart from meanflock's version; where it differs, last bits of flights may."""
        return {name: getattr(self, name) for name in versions_here()}


def versions_here() -> dict[str, str]:
    """What flies in this process, apart from meanflock's version."""
    return {
        "code": version(),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "machine": f"{platform.system()} {platform.machine()}",
        "kernels": kernels.BACKEND,
    }


def study_record(
    command: str, names: Sequence[str], scenarios: Mapping[Point, Sequence[Scenario]], flown: Points, out: Path
) -> StudyRecord:
    """The record of a study that has just flown, whose tables are in `out`."""
    tables = {point: flat(as_builtins(flights[0].resolved())) for point, flights in scenarios.items()}
    first, *others = tables.values()
    shared = {key: value for key, value in first.items() if all(table.get(key) == value for table in others)}
    shared.pop("seed", None)
    records = [
        PointRecord(
            list(point), {key: value for key, value in tables[point].items() if key not in shared and key != "seed"},
            flight_records(names, point, flown[point]),
        )
        for point in scenarios
    ]  # fmt: skip
    return StudyRecord(
        schema=SCHEMA,
        command=command,
        meanflock=__version__,
        commit=commit(),
        **versions_here(),
        plugins=plugins_that_fly(scenarios),
        names=list(names),
        keys=shared,
        points=records,
        files={name: sha256_of(out / name) for name in TABLES if (out / name).exists()},
    )


def plugins_that_fly(scenarios: Mapping[Point, Sequence[Scenario]]) -> list[tuple[str, str, str]]:
    """Kind, name and fingerprint of the plug-ins of all points."""
    return sorted({each for flights in scenarios.values() for each in plugins_of(flights[0])})


def flight_records(names: Sequence[str], point: Point, summaries: Sequence[Mapping[str, Any]]) -> list[FlightRecord]:
    """The records of the flights of a point."""
    numbers = reproducible(flight_table(names, {point: summaries}))
    return [
        FlightRecord(
            summary["seed"], summary["scenario_sha256"], summary["trajectory_sha256"], _sha256(row),
            _sha256(summary[EACH_ROUND]),
        )
        for summary, row in zip(summaries, numbers, strict=True)
    ]  # fmt: skip


def reproducible(table: pa.Table) -> list[dict[str, Any]]:
    """The rows of a table of flights with the columns that are the same wherever the flights are flown again; without
    unknown values.
    """
    columns = [name for name in table.column_names if name.partition(".")[0] not in VARYING]
    rows = table.select(columns).to_pylist()
    return [{name: value for name, value in row.items() if value is not None} for row in rows]


def write(record: StudyRecord, out: Path) -> Path:
    """Write `out`/study.json, completely or not at all; raises RunFailed."""
    return durable.put(out / STUDY_FILE, msgspec.json.format(msgspec.json.encode(record), indent=1) + b"\n")


def read(path: Path) -> StudyRecord:
    """The record in a file.

    Raises:
        BadInput: it is missing, damaged, or of another version of meanflock.
    """
    try:
        raw = paths.read(path, paths.LOG_BYTES)
    except OSError as error:
        raise BadInput(f"{path}: {error.strerror}; name the {STUDY_FILE} of a study, in the folder of --out") from error
    try:
        table = json.loads(raw)
        if not isinstance(table, dict):
            raise ValueError("not the record of a study")
        flown_by = table.get("meanflock", __version__)
        if flown_by == __version__:
            record = msgspec.json.decode(raw, type=StudyRecord)
            _check(record)
            return record
    except (ValueError, TypeError, RecursionError) as error:
        raise BadInput(
            f"{path}: damaged: {error}; remove it and repeat the command of the study, which writes it anew"
        ) from error
    raise BadInput(
        f"{path}: flown with meanflock {flown_by}, and this is {__version__}, whose flights may differ; install that "
        f"version: pip install meanflock=={flown_by}"
    )


def _check(record: StudyRecord) -> None:
    """Raises ValueError if a record has another schema, no point, or points that are not those of a study."""
    if record.schema != SCHEMA:
        raise ValueError(f"schema {record.schema}, expected {SCHEMA}")
    if not record.points:
        raise ValueError("no points")
    found = set()
    for point in record.points:
        if len(point.values) != len(record.names):
            raise ValueError(f"point {point.values} has {len(point.values)} values of {len(record.names)} names")
        if (values := _hashable(point.values)) in found:
            raise ValueError(f"two points {point.values}")
        if not point.flights:
            raise ValueError(f"point {point.values} has no flights")
        found.add(values)


def check_folder(out: Path, scenarios: Mapping[Point, Sequence[Scenario]]) -> None:
    """Check that the folder has no study, or one of which all flights are among these: more values, methods or seeds.

    Raises:
        BadInput: it has another study, whose results would be lost, or a record that is damaged or of another version.
    """
    path = out / STUDY_FILE
    if not path.exists():
        return
    try:
        before = read(path)
    except BadInput as error:
        raise BadInput(f"{error}; or name another folder: --out DIR") from error
    there = {flight.scenario_sha256 for point in before.points for flight in point.flights}
    if not there <= {flown.sha256() for flights in scenarios.values() for flown in flights}:
        raise BadInput(f"{out}: it has another study, `{before.command}`; name another folder: --out DIR")


def sha256_of(path: Path) -> str:
    """Hash of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _sha256(value: Any) -> str:
    """Hash of a value as canonical JSON."""
    return hashlib.sha256(msgspec.json.encode(value, order="deterministic")).hexdigest()


def _hashable(values: Any) -> Any:
    return tuple(map(_hashable, values)) if isinstance(values, list) else values
