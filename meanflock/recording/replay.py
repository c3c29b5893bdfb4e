"""Recording files: check, repair and read them, continue one, and complete one from its run folder.

A recorder gathers some hundred ticks before it sends them, while the time series is written block by block. So a
recorder that is killed leaves a time series that is longer than its recording.
"""

import logging
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray
from rerun.chunk import RrdReader

from meanflock.recording import blueprint, plots
from meanflock.recording.recorder import Recorder
from meanflock.recording.viewer import reason, run_program
from meanflock.results import inbound
from meanflock.results.event_log import event_text, past_events
from meanflock.results.run_folder import EVENTS, RECORDING, SCENARIO
from meanflock.results.series import Reported, block_of, unbroken
from meanflock.results.timeseries_file import Past, past
from meanflock.swarm import scenario
from meanflock.swarm.errors import BadInput, MessageRejected, RunFailed
from meanflock.swarm.events import FlightEvent
from meanflock.swarm.wire.messages import Telemetry

_BLOCK_TICKS = 500

log = logging.getLogger("meanflock.recording")


def verify(path: Path) -> str | None:
    """The fault of a recording; None: it has none."""
    if not path.is_file():  # the program would wait for a pipe, and read a device without end
        return "not a regular file"
    done = run_program("rrd", "verify", path)
    if done.returncode != 0:
        return reason(done)
    return None if _holds_a_run(path) else "there is no recording in it"


def repair(path: Path) -> None:
    """Rewrites a recording that was cut off, in place, with all of it that can be read.

    Raises:
        RunFailed: nothing of it can be read; the file is left as it was.
    """
    if not path.is_file():
        raise RunFailed(f"{path}: not a regular file; the recording cannot be repaired")
    repaired = path.with_name(f".{path.name}.mended")
    try:
        done = run_program("rrd", "optimize", path, "-o", repaired)
        if done.returncode != 0 or not repaired.exists():
            raise RunFailed(f"{path}: the recording cannot be repaired: {reason(done)}")
        if not _holds_a_run(repaired):
            raise RunFailed(f"{path}: nothing of a flight can be read of the recording; it is left as it was")
        repaired.replace(path)
    finally:
        repaired.unlink(missing_ok=True)


def _holds_a_run(path: Path) -> bool:
    """Returns whether a recording has more than a blueprint; Rerun's program accepts a file that was cut after that."""
    try:
        RrdReader(path.absolute()).stream()
    except (RuntimeError, ValueError):
        return False
    return True


class Continued:
    """Moves an older recording of a run aside while a new one is written, and joins them at the end."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.earlier: list[Path] = []  # the older recordings that can be read

    def __enter__(self) -> "Continued":
        # A process that was killed before it joined them leaves more than one.
        aside = sorted(self._path.parent.glob(f".earlier-*.{self._path.name}"))
        if self._path.exists():
            aside.append(self._path.replace(self._path.with_name(f".earlier-{len(aside):03}.{self._path.name}")))
        for part in aside:
            try:
                if verify(part) is not None:
                    repair(part)
                self.earlier.append(part)
            except RunFailed as error:
                log.warning("%s", error)
        return self

    def __exit__(self, *_: object) -> None:
        """Joins all recordings that can be read; if that fails, they stay as separate files."""
        if not self.earlier or not self._path.exists():
            return
        joined = self._path.with_name(f".joined.{self._path.name}")
        try:
            if run_program("rrd", "merge", *self.earlier, self._path, "-o", joined).returncode == 0 and joined.exists():
                joined.replace(self._path)
                for part in self.earlier:
                    part.unlink()
        finally:
            joined.unlink(missing_ok=True)


@dataclass(frozen=True)
class Recorded:
    """The contents of recordings of a run: ticks (R,) that are complete, and lines of the log with their ticks."""

    ticks: NDArray[np.int64]
    lines: set[tuple[int, str]]


def recorded(parts: Iterable[Path]) -> Recorded:
    """Reads recordings that `verify` accepts."""
    ticks: list[int] = []
    lines: set[tuple[int, str]] = set()
    for part in parts:
        ticks += [tick for tick, _ in _rows(part, plots.LAST.entity, "Scalars:scalars")]
        lines |= {(tick, text[0]) for tick, text in _rows(part, blueprint.EVENTS, "TextLog:text")}
    return Recorded(np.unique(np.array(ticks, dtype=np.int64)), lines)


def _rows(path: Path, entity: str, component: str) -> Iterator[tuple[int, Any]]:
    for chunk in RrdReader(path.absolute()).stream().filter(content=f"/{entity}"):
        batch = chunk.to_record_batch()
        if {blueprint.TICKS, component} <= set(batch.schema.names):
            ticks = batch.column(blueprint.TICKS).to_pylist()
            yield from zip(ticks, batch.column(component).to_pylist(), strict=True)


def complete(folder: Path) -> None:
    """Repairs the recording of a run that was killed and fills it up from the time series.

    Raises:
        BadInput: time series or events are damaged.
        RunFailed: nothing of the recording can be read, and there is no time series; the file is left as it was.
    """
    path = folder / RECORDING
    if verify(path) is None:
        return
    try:
        flown, series = scenario.load(folder / SCENARIO), past(folder)
    except BadInput:  # a recording alone
        repair(path)
        return
    _events(folder, series, flown.uavs)  # before any file is moved
    reported = Reported.within(series.rows)
    with Continued(path) as before, Recorder(flown, folder.name, path, reported=reported) as recorder:
        for block in missing(folder, series, recorded(before.earlier), flown.uavs):
            recorder.write(block)


def missing(folder: Path, series: Past, present: Recorded, uavs: int) -> Iterator[Telemetry]:
    """Rows and events of the flight in `folder` that `present` lacks, in the order of the ticks.

    The blocks have no links, which no file but a recording has.

    Raises:
        BadInput: the rows or events are not those of a flight of so many UAVs.
    """
    rows = series.rows.filter(pc.invert(pc.is_in(series.rows["tick"], pa.array(present.ticks, pa.int32()))))
    left = [event for event in _events(folder, series, uavs) if (event.tick, event_text(event)) not in present.lines]
    try:
        pieces = list(unbroken(rows, _BLOCK_TICKS))
        for number, piece in enumerate(pieces):
            up_to = piece["tick"][-1].as_py() if number + 1 < len(pieces) else math.inf
            now = tuple(event for event in left if event.tick <= up_to)
            left = [event for event in left if event.tick > up_to]
            yield inbound.check(block_of(piece, number, now), uavs)
    except (MessageRejected, ValueError, TypeError, KeyError) as error:
        raise BadInput(f"{folder}: time series or events are damaged ({error})") from error


def _events(folder: Path, series: Past, uavs: int) -> list[FlightEvent]:
    """Read the events; raises BadInput if some are missing or damaged."""
    view = f", or look at what there is: `meanflock view {folder / RECORDING}`"
    remedy = f"bring the file back{view if (folder / RECORDING).exists() else ''}"
    return past_events(folder / EVENTS, series.events_bytes, uavs, remedy)
