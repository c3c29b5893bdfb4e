"""A flight in its run folder, read piece by piece. It needs neither the controller nor the plug-ins that flew."""

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import msgspec
import pyarrow as pa
from msgspec import Meta, field

from meanflock.results.event_log import past_events
from meanflock.results.run_folder import EVENTS, SCENARIO, SUMMARY, check_flown, check_uavs, unreadable
from meanflock.results.scenario_name import name_in
from meanflock.results.timeseries_file import TIMESERIES, SeriesReader
from meanflock.swarm import paths, toml
from meanflock.swarm.errors import BadInput
from meanflock.swarm.events import FlightEvent
from meanflock.swarm.scenario import Destination, Energy, GroupTable, Metrics, Obstacle, Space, Start, Station

_MEND = "bring the file back, or fly the run again"
_PIECE_STATES = 50_000  # UAVs × ticks that are in memory at once


class FlownKeys(msgspec.Struct):
    """The keys of a scenario that plots and exports show; they can be read without its controller."""

    method: str = ""  # empty: there is no scenario
    seed: int = 0
    uavs: Annotated[int, Meta(ge=1)] = 1
    dt: Annotated[float, Meta(ge=1e-6, le=1e3)] = 0.1
    space: Space = field(default_factory=Space)
    start: Start = field(default_factory=Start)
    destination: Destination = field(default_factory=Destination)
    metrics: Metrics = field(default_factory=Metrics)
    obstacles: tuple[Obstacle, ...] = ()
    stations: tuple[Station, ...] = ()
    energy: Energy = field(default_factory=Energy)
    groups: tuple[GroupTable, ...] = ()


class StoredScenario(NamedTuple):
    """The scenario file of a run: its table, the keys that are typed without the controller, and its name, if any."""

    table: dict[str, Any]
    typed: FlownKeys
    name: str | None


def flown_keys(folder: Path) -> FlownKeys:
    """The scenario of a run; the default if the file is missing. Raises BadInput if it is damaged."""
    path = folder / SCENARIO
    return read_keys(path).typed if os.path.lexists(path) else FlownKeys()


def read_keys(path: Path) -> StoredScenario:
    """The scenario file of a run.

    Raises:
        BadInput: the file is missing, or not the scenario of a run.
    """
    try:
        raw = paths.read(path)
        table = toml.parse(raw)
        json.dumps(table, allow_nan=False)  # no scenario has dates, or numbers that are not finite
        return StoredScenario(table, msgspec.convert(table, FlownKeys), name_in(raw.decode("utf-8-sig")))
    except OSError as error:
        raise BadInput(f"{path}: {error.strerror}; {_MEND}") from error
    except msgspec.ValidationError as error:
        raise BadInput(f"{path}: {error}; {_MEND}") from error
    except (ValueError, TypeError, RecursionError) as error:
        raise BadInput(f"{path}: not TOML, or not the scenario of a run: {error}; {_MEND}") from error


class Piece(NamedTuple):
    """Rows of the time series, and the events up to the last of them since the piece before."""

    rows: pa.Table
    events: list[FlightEvent]


class FlightSoFar:
    """A flight up to its end, or up to where a run was killed.

    scenario: of the run. ticks: number of rows. columns: of the time series. finished: whether the run has a summary.
    take_off_ns: time of take-off on the clock of an export, in ns since 1970.
    """

    def __init__(self, folder: Path, take_off_ns: int = 0) -> None:
        """Open a run.

        Raises:
            BadInput: no run there, a damaged file, or a run that never took off.
        """
        if not (folder / SCENARIO).is_file():
            raise BadInput(f"{folder}: no run; name the folder of one")
        self.folder = folder
        self.take_off_ns = take_off_ns
        self.scenario = flown_keys(folder)
        self._path = folder / TIMESERIES
        try:
            self._series = SeriesReader(self._path)
        except OSError as error:
            raise unreadable(self._path, error) from error
        check_flown(self._path, self._series.ticks)
        self.ticks = self._series.ticks
        self.columns = self._series.columns
        self.finished = (folder / SUMMARY).is_file()
        remedy = "bring the file back"
        self._events = past_events(folder / EVENTS, self._series.events_bytes, self.scenario.uavs, remedy)

    def pieces(self) -> Iterator[Piece]:
        """The flight in the order of the ticks.

        Raises:
            BadInput: the time series is damaged.
        """
        done = 0
        left = self._events
        try:
            for rows in self._series.pieces(max(1, _PIECE_STATES // self.scenario.uavs)):
                check_uavs(self._path, rows, self.scenario.uavs)
                done += len(rows)
                last = rows["tick"][-1].as_py()
                now = [event for event in left if event.tick <= last or done == self.ticks]
                left = left[len(now) :]
                yield Piece(rows, now)
        except OSError as error:
            raise unreadable(self._path, error) from error
