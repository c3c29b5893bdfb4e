"""Recording files: check and read them, continue one, and complete one from its run folder.

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
from meanflock.swarm.errors import BadInput, MessageRejected
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


def _holds_a_run(path: Path) -> bool:
    """Returns whether a recording has more than a blueprint; Rerun's program accepts a file that was cut after that."""
    try:
        RrdReader(path.absolute()).stream()
    except (RuntimeError, ValueError):
        return False
    return True


def _join(parts: Iterable[Path], path: Path) -> bool:
    """Write all that can be read of recordings, which may be cut off, to `path`.

    Returns:
        Whether there is a run in it; if not, nothing is written.
    """
    joined = path.with_name(f".joined.{path.name}")
    try:
        done = run_program("rrd", "merge", *parts, "-o", joined)
        if done.returncode != 0 or not joined.exists() or not _holds_a_run(joined):
            return False
        joined.replace(path)
        return True
    finally:
        joined.unlink(missing_ok=True)


class Continued:
    """Moves an older recording of a run aside while a new one is written, and joins them at the end.

    Only a recording has the radio links, so of one that was cut off all is kept that can be read.
    """

    def __init__(self, path: Path, run_id: str) -> None:
        """`run_id`: name of the new recording if there is no older one."""
        self._path = path
        self.run_id = run_id  # the folder may have been renamed, and recordings of two names would not be joined
        self.earlier: list[Path] = []  # the older recordings that can be read

    def __enter__(self) -> "Continued":
        # A process that was killed before it joined them leaves more than one.
        aside = sorted(self._path.parent.glob(f".earlier-*.{self._path.name}"))
        if self._path.exists():
            aside.append(self._path.replace(self._path.with_name(f".earlier-{len(aside):03}.{self._path.name}")))
        for part in aside:
            if verify(part) is None or (part.is_file() and _join([part], part)):
                self.earlier.append(part)
            else:
                log.warning("%s: nothing of a flight can be read of this recording; it is left as it was", part)
        if self.earlier:
            self.run_id = RrdReader(self.earlier[-1].absolute()).recordings()[0].recording_id
        return self

    def __exit__(self, *_: object) -> None:
        """Joins all recordings that can be read; if that fails, they stay as separate files."""
        if self.earlier and self._path.exists() and _join([*self.earlier, self._path], self._path):
            for part in self.earlier:
                part.unlink()


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
    """Completes the recording of a run that was killed: what it lacks is drawn from the time series.

    Raises:
        BadInput: scenario, time series or events are missing or damaged; the recording is left as it was.
    """
    path = folder / RECORDING
    if verify(path) is None:
        return
    try:
        flown, series = scenario.load(folder / SCENARIO), past(folder)
    except BadInput as error:
        raise BadInput(f"{path}: cut off or damaged; to complete it, bring back what is missing: {error}") from error
    _events(folder, series, flown.uavs)  # before any file is moved
    reported = Reported.within(series.rows)
    with Continued(path, folder.name) as before, Recorder(flown, before.run_id, path, reported=reported) as recorder:
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
    return past_events(folder / EVENTS, series.events_bytes, uavs, "bring the file back")
