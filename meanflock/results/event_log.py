"""The events of a run: their kinds, and the file with a line each, appended by the one process that writes the run."""

import fcntl
import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import IO, Any

from meanflock.swarm import durable, paths
from meanflock.swarm.errors import BadInput, printable
from meanflock.swarm.events import LEVELS, FlightEvent, Level, Untyped, event_of, fields_of

FIELDS = {  # of a line
    "tick": "number of the tick",
    "sim_time_s": "simulated time of the tick, s",
    "kind": "one of the kinds below",
    "text": "what happened, in words",
    "uavs": "numbers of the UAVs concerned, if there are any",
    "event": "type of the event, which says what its fields are",
    "fields": "object with all fields of the event that the line does not have already",
}

_LAST_BYTES = 65536  # room for the line of the event that ends a flight, whose reason is in it twice and in escapes


class EventLog:
    """File of the events; while it is open, the run folder is locked."""

    def __init__(self, path: Path, dt: float) -> None:
        """Opens or creates the file; a tick takes `dt` seconds.

        Raises:
            BadInput: another process writes it. OSError: it cannot be written.
        """
        flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
        self._file, self._dt = os.fdopen(os.open(path, flags, 0o666), "ab", buffering=0), dt
        try:
            lock(self._file, path.parent)
        except BadInput:
            self._file.close()
            raise

    @property
    def size(self) -> int:
        """Bytes so far."""
        return os.fstat(self._file.fileno()).st_size

    def append(self, events: Iterable[FlightEvent]) -> None:
        """Append events, a line each. Raises OSError if there is no room; a part may be written."""
        self.write("".join(json.dumps(row_of(event, self._dt)) + "\n" for event in events).encode())

    def write(self, content: bytes) -> None:
        """Appends bytes."""
        durable.write(self._file, content)

    def truncate(self, size: int) -> None:
        """Delete everything after the first `size` bytes."""
        os.ftruncate(self._file.fileno(), size)

    def fileno(self) -> int:
        """The handle of the file."""
        return self._file.fileno()

    def close(self) -> None:
        """Close the file and unlock the folder."""
        self._file.close()


def row_of(event: FlightEvent, dt: float) -> dict[str, Any]:
    """An event as a row of the file; a tick takes `dt` seconds."""
    row = {"tick": event.tick, "sim_time_s": round(event.tick * dt, 6), "kind": event.kind}
    row |= {"text": event.text, "uavs": list(event.uavs)}
    fields = {name: value for name, value in fields_of(event).items() if name not in row}
    return row | {"event": event.__struct_config__.tag, "fields": fields}


def event_of_row(row: Mapping[str, Any]) -> FlightEvent:
    """The event of a row. Raises ValueError, TypeError, KeyError or OverflowError if it is invalid."""
    if "event" not in row:
        return Untyped(int(row["tick"]), str(row["kind"]), str(row["text"]), tuple(map(int, row["uavs"])))
    return event_of(row["event"], {**row, **row["fields"]})


def event_text(event: FlightEvent) -> str:
    """An event as a log shows it."""
    return printable(event.text if event.kind in event.text else f"{event.kind}: {event.text}")


def event_level(event: FlightEvent) -> Level:
    """The severity of an event in a log."""
    return LEVELS.get(event.kind, "INFO")


def lock(file: IO[Any], folder: Path) -> None:
    """Lock a run folder while `file`, its events, is open. Raises BadInput if it is locked."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        raise BadInput(f"{folder}: another process still writes this run; let it end first") from error


def past_events(path: Path, size: int, uavs: int, remedy: str) -> list[FlightEvent]:
    """Read the events in the first `size` bytes of the file.

    Raises:
        BadInput: some of them are missing or damaged; `remedy` is the advice in the message.
    """
    try:
        content = paths.read(path, paths.LOG_BYTES)[: max(0, size)]
        if len(content) < size:
            raise ValueError(f"{len(content)} bytes of the {size} that belong to what was flown")
        return [_event(json.loads(line), uavs) for line in content.splitlines()]
    except OSError as error:
        raise BadInput(f"{path}: {error.strerror}; {remedy}") from error
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError) as error:
        raise BadInput(f"{path}: damaged ({error}); {remedy}") from error


def stored_lines(path: Path) -> list[bytes]:
    """The lines of the file; the last one may be cut off. Raises BadInput if the file cannot be read."""
    try:
        return paths.read(path, paths.LOG_BYTES).splitlines()
    except OSError as error:
        raise BadInput(f"{path}: {error.strerror}; fly the run again") from error


def last_event(events: IO[bytes]) -> tuple[str, str]:
    """Kind and text of the last event in a file of events; empty where it has none, or one that is cut off."""
    events.seek(max(0, os.fstat(events.fileno()).st_size - _LAST_BYTES))
    lines = events.read().splitlines()
    try:
        row = json.loads(lines[-1])
        return str(row["kind"]), str(row["text"])
    except (LookupError, TypeError, ValueError, RecursionError):
        return "", ""


def _event(row: Any, uavs: int) -> FlightEvent:
    """Parse a row; raises ValueError, TypeError, KeyError or OverflowError if it is invalid."""
    event = event_of_row(row)
    named = event.all_uavs
    if event.tick < 0 or any(not 0 <= uav < uavs for uav in named):
        raise ValueError(f"an event of tick {event.tick} and UAVs {named}")
    return event
