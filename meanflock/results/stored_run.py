"""Run folders as they lie on the disk: which runs a folder has, their state, summary and scenario. Writes nothing."""

import os
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any, Literal, TypeAlias

from meanflock.results.event_log import last_event, lock
from meanflock.results.flown import read_keys
from meanflock.results.quantities import DERIVED
from meanflock.results.quantities import SUMMARY as FIELDS
from meanflock.results.run_folder import CHECKPOINT, EVENTS, SCENARIO, SUMMARY, go_on
from meanflock.results.scenario_keys import NamedMission, flat, flown_mission
from meanflock.results.summary_file import read_summary
from meanflock.swarm import mission, paths
from meanflock.swarm.errors import BadInput, printable

Status: TypeAlias = Literal["finished", "interrupted", "unfinished", "flying", "damaged"]
_NAMED = re.compile(r"(\d{8}-\d{6})-")  # the local time at the start of a run's name
_ZONE_STEP_S = 900  # time zones differ by multiples of it
_ZONES_S = (-12 * 3600, 14 * 3600)  # the least and the greatest time zone
_BEGINNING_S = 10.0  # at most between the naming of a run and the writing of its scenario
_LONGEST_REASON = 1000  # characters
_FLY_ONE = "fly one with `meanflock run`, or name"  # where there is no run yet
_UNITS = {known.key: known.unit for known in (*FIELDS, *DERIVED)}


@dataclass(frozen=True)
class StoredFolder:
    """A run folder.

    when: UTC time at which the run began, see `began`. fault: why it is damaged. summary:
    empty if there is none, or it is damaged. keys: of its scenario, dotted; empty if the file cannot be read.
    scenario: its name; None: the folder does not say it. failure: why the flight failed; empty if it did not.
    method: its controller by the scenario; of groups, those of all, joined by "+"; None if the file cannot be read.
    resumable: whether it did not finish and has a checkpoint.
    """

    folder: Path
    when: datetime
    status: Status
    fault: str = ""
    summary: dict[str, Any] = field(default_factory=dict)
    keys: dict[str, Any] = field(default_factory=dict)
    method: str | None = None
    scenario: str | None = None
    resumable: bool = False
    failure: str = ""

    @property
    def mission(self) -> NamedMission | None:
        """The scenario that was flown; None if its file cannot be read."""
        return flown_mission(self.keys, self.scenario) if self.keys else None

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
        return self.summary.get(key, self.method if key == "method" else self.keys.get(key))


def is_run(folder: Path) -> bool:
    """Returns whether a folder is that of a run."""
    return any(os.path.lexists(folder / name) for name in (SCENARIO, SUMMARY))


def runs_in(folder: Path, progress: Callable[[int, int], None] = lambda _done, _all: None) -> list[StoredFolder]:
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
        raise BadInput(f"{folder}: {error.strerror}; {_FLY_ONE} a folder with runs") from error
    runs = []
    for number, path in enumerate(found, 1):
        runs.append(_read(path))
        progress(number, len(found))
    return sorted(runs, key=lambda run: (run.when, run.run_id), reverse=True)


def latest(parent: Path, *, is_resumable: bool = False) -> Path:
    """The folder of the run in `parent` that began last, or of the last one that can be resumed.

    Raises:
        BadInput: there is none.
    """
    wanted = "that can be resumed" if is_resumable else ""
    try:
        found = [path for path in parent.iterdir() if is_run(path)]
    except OSError:
        found = []
    for path in sorted(found, key=lambda path: (began(path), path.name), reverse=True):
        if not is_resumable or _read(path).resumable:
            return path
    remedy = f"{'name' if found else _FLY_ONE} the folder of one"
    raise BadInput(f"latest: there is no run {wanted}".rstrip() + f" in {parent.absolute()}; {remedy}")


def stored_run(folder: Path) -> StoredFolder:
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


def finished_run(folder: Path) -> StoredFolder:
    """The run in a folder, which has finished.

    Raises:
        BadInput: as for `stored_run`; or the run has not finished.
    """
    run = stored_run(folder)
    if run.status == "flying":
        raise BadInput(f"{folder}: the run still flies; wait for its end")
    if run.status != "finished":
        why = f", because it failed: {run.failure}" if run.failure else ""
        raise BadInput(f"{folder}: the run has not finished{why}; {go_on(folder)}")
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


def _read(folder: Path) -> StoredFolder:
    fault = ""
    summary: dict[str, Any] = {}
    keys: dict[str, Any] = {}
    method: str | None = None
    name: str | None = None
    status: Status = "damaged"
    try:
        stored = read_keys(folder / SCENARIO)
        keys, method, name = flat(stored.table), mission.method(stored.typed), stored.name
        if os.path.lexists(folder / SUMMARY):
            summary = read_summary(folder / SUMMARY)
        status = status_of(folder)
    except BadInput as error:
        fault = str(error)
    except RecursionError:
        fault = f"{SCENARIO}: tables are nested too deeply; bring the file back, or fly the run again"
    resumable = status in ("interrupted", "unfinished") and (folder / CHECKPOINT).exists()
    failure = _failure(folder) if status == "unfinished" else ""
    return StoredFolder(
        folder, began(folder), status, printable(fault), summary, keys, method, name, resumable, failure
    )


def status_of(folder: Path) -> Status:
    """The status of a run whose records can be read; raises BadInput if its events cannot be read."""
    has_summary = os.path.lexists(folder / SUMMARY)
    if has_summary and (folder / CHECKPOINT).exists():
        return "interrupted"
    try:
        with paths.opened(folder / EVENTS) as events:
            if has_summary:
                return "finished" if last_event(events)[0] == "finished" else "interrupted"
            try:
                lock(events, folder)
            except BadInput:
                return "flying"
    except FileNotFoundError:
        return "finished" if has_summary else "unfinished"
    except OSError as error:
        raise BadInput(f"{folder / EVENTS}: {error.strerror}; bring the file back, or fly the run again") from error
    return "unfinished"


def _failure(folder: Path) -> str:
    """Why a flight failed, by its last event; empty if that does not say it."""
    try:
        with paths.opened(folder / EVENTS) as events:
            kind, text = last_event(events)
    except OSError:
        return ""
    return printable(text, _LONGEST_REASON) if kind == "failed" else ""


def began(folder: Path) -> datetime:
    """UTC time at which a run began.

    The name of a run has its local time. The time of the scenario file is that instant, if it fits the name in any time
    zone; that of a copy does not. Else the name is taken for local time here, and without one the file decides.
    """
    times = [path.lstat().st_mtime for name in (SCENARIO, SUMMARY) if os.path.lexists(path := folder / name)]
    written = datetime.fromtimestamp(times[0] if times else 0.0, UTC)
    named = _NAMED.match(folder.name)
    try:
        local = datetime.strptime(named[1], "%Y%m%d-%H%M%S") if named else None
    except ValueError:
        local = None
    if local is None:
        return written
    ahead_s = (local.replace(tzinfo=UTC) - written).total_seconds()
    zone_s = round((ahead_s + _BEGINNING_S / 2) / _ZONE_STEP_S) * _ZONE_STEP_S
    if _ZONES_S[0] <= zone_s <= _ZONES_S[1] and -_BEGINNING_S <= ahead_s - zone_s <= 0.0:
        return written
    return local.astimezone(UTC)
