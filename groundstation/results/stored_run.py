"""Run folders as they lie on the disk: which runs a folder has, their state, summary and scenario. Writes nothing."""

import json
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime
from functools import cache
from pathlib import Path
from typing import Any, Literal, TypeAlias

from meanflock.groundstation.results.quantities import SUMMARY as FIELDS
from meanflock.groundstation.results.run_folder import CHECKPOINT, EVENTS, SCENARIO, SUMMARY, alone
from meanflock.groundstation.results.scenario_keys import flat
from meanflock.swarm import toml
from meanflock.swarm.errors import BadInput, printable
from meanflock.worldsim.summary import SCHEMA

Status: TypeAlias = Literal["finished", "interrupted", "unfinished", "flying", "damaged"]
RESUMABLE = ("interrupted", "unfinished")
_NAMED = re.compile(r"(\d{8}-\d{6})-")  # the time at the start of a run's name
_MEND = "bring the file back, or fly the run again"
_UNITS = {known.key: known.unit for known in FIELDS}


@dataclass(frozen=True)
class StoredRun:
    """A run folder.

    when: local time of take-off, by the name of the run, else by its scenario file. fault: why it is damaged. summary:
    empty if there is none, or it is damaged. keys: of its scenario, dotted; empty if the file cannot be read.
    """

    folder: Path
    when: datetime
    status: Status
    fault: str = ""
    summary: dict[str, Any] = field(default_factory=dict)
    keys: dict[str, Any] = field(default_factory=dict)

    @property
    def run_id(self) -> str:
        """Name of the run."""
        return printable(self.folder.name)

    def figure(self, key: str) -> Any:
        """A field of the summary by its dotted key; None if it is unknown."""
        value: Any = self.summary
        for part in key.split("."):
            value = value.get(part) if isinstance(value, dict) else None
        return value

    def named(self, key: str) -> Any:
        """`method`, `uavs` or `seed`, by the summary, else by the scenario; None if neither can be read."""
        return self.summary.get(key, self.keys.get(key))


def is_run(folder: Path) -> bool:
    """Returns whether a folder is that of a run."""
    return (folder / SCENARIO).is_file() or (folder / SUMMARY).is_file()


def runs_in(folder: Path, progress: Callable[[int, int], None] = lambda _done, _all: None) -> list[StoredRun]:
    """All runs in a folder, the latest first.

    Args:
        progress: called with the number of runs that were read, and of all runs.

    Raises:
        BadInput: there is no such folder, or it is the folder of a run.
    """
    if is_run(folder):
        raise BadInput(f"{folder}: the folder of a run; name the folder above it, or use `meanflock show {folder}`")
    try:
        found = [path for path in folder.iterdir() if is_run(path)]
    except OSError as error:
        raise BadInput(f"{folder}: {error.strerror}; name a folder with runs") from error
    runs = []
    for number, path in enumerate(found, 1):
        runs.append(_read(path))
        progress(number, len(found))
    return sorted(runs, key=lambda run: (run.when, run.run_id), reverse=True)


def stored_run(folder: Path) -> StoredRun:
    """The run in a folder.

    Raises:
        BadInput: there is no run, one of its files is damaged, or its record is of another version.
    """
    if not is_run(folder):
        raise BadInput(f"{folder}: no run; name the folder of one, for example as `meanflock list` prints it")
    run = _read(folder)
    if run.fault:
        raise BadInput(f"{folder}: {run.fault}")
    return run


def finished_run(folder: Path) -> StoredRun:
    """The run in a folder, which has finished.

    Raises:
        BadInput: as for `stored_run`; or the run has not finished.
    """
    run = stored_run(folder)
    if run.status == "flying":
        raise BadInput(f"{folder}: the run still flies; wait for its end")
    if run.status in RESUMABLE:
        raise BadInput(f"{folder}: the run has not finished; `meanflock resume {folder}`")
    return run


@cache
def unit_of(key: str) -> str:
    """Unit of a field of the summary by its dotted key, of which a part may stand for any name; empty: no number."""
    parts = key.split(".")
    for known, unit in _UNITS.items():
        pattern = known.split(".")
        if len(pattern) == len(parts) and all(one in ("*", part) for one, part in zip(pattern, parts, strict=True)):
            return unit
    return ""


def _read(folder: Path) -> StoredRun:
    fault = ""
    summary = {}
    keys = {}
    try:
        keys = flat(toml.read(folder / SCENARIO, "scenario file"))
        if (folder / SUMMARY).exists():
            summary = _summary(folder / SUMMARY)
    except BadInput as error:
        fault = str(error)
    status = "damaged" if fault else _status(folder)
    return StoredRun(folder, _when(folder), status, printable(fault), summary, keys)


def _summary(path: Path) -> dict[str, Any]:
    """A summary; raises BadInput if it is damaged or of another version."""
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise BadInput(f"{SUMMARY}: {error.strerror}; {_MEND}") from error
    except (ValueError, RecursionError) as error:
        raise BadInput(f"{SUMMARY}: damaged: not JSON; {_MEND}") from error
    if not isinstance(summary, dict):
        raise BadInput(f"{SUMMARY}: damaged: no object; {_MEND}")
    if (version := summary.get("schema")) != SCHEMA:
        raise BadInput(
            f"{SUMMARY}: a record of version {version!r}, written by meanflock {summary.get('version')}; this "
            f"meanflock reads version {SCHEMA}: use the meanflock that wrote it"
        )
    for key in _UNITS:
        if key.partition(".")[0] not in summary:
            raise BadInput(f"{SUMMARY}: damaged, or of another meanflock: it has no `{key}`; {_MEND}")
    for key, value in flat(summary).items():
        if unit_of(key) and not isinstance(value, int | float):
            raise BadInput(f"{SUMMARY}: damaged: `{key}` is no number; {_MEND}")
    return summary


def _status(folder: Path) -> Status:
    if (folder / SUMMARY).exists():
        return "interrupted" if (folder / CHECKPOINT).exists() else "finished"
    try:
        with alone(folder):
            return "unfinished"
    except BadInput:
        return "flying"


def _when(folder: Path) -> datetime:
    named = _NAMED.match(folder.name)
    try:
        if named:
            return datetime.strptime(named[1], "%Y%m%d-%H%M%S")
    except ValueError:
        pass
    path = next(path for name in (SCENARIO, SUMMARY, EVENTS) if (path := folder / name).is_file())
    return datetime.fromtimestamp(path.stat().st_mtime).replace(microsecond=0)
