"""What a run folder keeps of a flight and its recording lacks, as telemetry again.

A recorder gathers some hundred ticks before it sends them, the time series is written block by block: whoever kills a
recorder takes its last ticks out of the recording alone.
"""

import math
from collections.abc import Iterator
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc

from meanflock.groundstation.recording.recorded import Recorded, line, recorded
from meanflock.groundstation.recording.recorder import Recorder
from meanflock.groundstation.recording.viewer import Continued, repair, verify
from meanflock.groundstation.reported import Reported
from meanflock.groundstation.results import inbound
from meanflock.groundstation.results.event_log import past_events
from meanflock.groundstation.results.run_folder import EVENTS, RECORDING, SCENARIO
from meanflock.groundstation.results.series import block_of, unbroken
from meanflock.groundstation.results.timeseries_file import Past, past
from meanflock.swarm import scenario
from meanflock.swarm.errors import BadInput, MessageRejected
from meanflock.swarm.wire.messages import Event, Telemetry

_BLOCK_TICKS = 500


def complete(folder: Path) -> None:
    """Mends the recording of a run that was killed: what of it can be read, and the rest from the time series.

    Raises:
        BadInput: time series or events are damaged.
        RunFailed: nothing can be read of the recording, and there is nothing else; it is left as it was.
    """
    path = folder / RECORDING
    if verify(path) is None:
        return
    try:
        flown, kept = scenario.load(folder / SCENARIO), past(folder)
    except BadInput:  # no folder of a run: a recording alone
        repair(path)
        return
    _events(folder, kept, flown.uavs)  # before anything is moved
    with Continued(path) as before, Recorder(flown, folder.name, path, reported=Reported.within(kept.rows)) as recorder:
        for block in missing(folder, kept, recorded(before.earlier), flown.uavs):
            recorder.write(block)


def missing(folder: Path, kept: Past, there: Recorded, uavs: int) -> Iterator[Telemetry]:
    """Rows and events that `kept` has of the flight in `folder` and that are not `there`, in the order of the ticks.

    Which links were used is nowhere but in a recording: these blocks have none.

    Raises:
        BadInput: the rows or events are not those of a flight of so many UAVs.
    """
    rows = kept.rows.filter(pc.invert(pc.is_in(kept.rows["tick"], pa.array(there.ticks, pa.int32()))))
    left = [event for event in _events(folder, kept, uavs) if (event.tick, line(event)) not in there.lines]
    try:
        pieces = list(unbroken(rows, _BLOCK_TICKS))
        for number, piece in enumerate(pieces):
            up_to = piece["tick"][-1].as_py() if number + 1 < len(pieces) else math.inf
            now = tuple(event for event in left if event.tick <= up_to)
            left = [event for event in left if event.tick > up_to]
            yield inbound.check(block_of(piece, number, now), uavs)
    except (MessageRejected, ValueError, TypeError, KeyError) as error:
        raise BadInput(f"{folder}: time series or events are damaged ({error})") from error


def _events(folder: Path, kept: Past, uavs: int) -> list[Event]:
    """Raises BadInput where some are missing or damaged."""
    mend = f"bring the file back, or look at what there is: `meanflock view {folder / RECORDING}`"
    return past_events(folder / EVENTS, kept.events_bytes, uavs, mend)
