"""What a run folder keeps of a flight and its recording lacks, as telemetry again.

A recorder gathers some hundred ticks before it sends them, the time series is written block by block: whoever kills a
recorder takes its last ticks out of the recording alone.
"""

import json
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from groundstation import inbound
from groundstation.recording import Recorded, Recorder, line, recorded
from groundstation.results import EVENTS, RECORDING, SCENARIO, Past, past, per_uav, states_of
from groundstation.viewer import Continued, repair, verify
from swarm import scenario
from swarm.errors import BadInput, MessageRejected
from swarm.messages import DIAGNOSTICS, SWARM_COLUMNS, Event, Telemetry
from swarm.model import MODEL_FLOATS

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
    with Continued(path) as before, Recorder(flown, folder.name, path) as recorder:
        for block in missing(folder, kept, recorded(before.earlier), flown.uavs):
            recorder.write(block)


def missing(folder: Path, kept: Past, there: Recorded, uavs: int) -> Iterator[Telemetry]:
    """Rows and events that `kept` has of the flight in `folder` and that are not `there`, in the order of the ticks.

    Which links were used is nowhere but in a recording: these blocks have none.

    Raises:
        BadInput: the rows or events are not those of a flight of so many UAVs.
    """
    rows = kept.rows.filter(pc.invert(pc.is_in(kept.rows["tick"], pa.array(there.ticks, pa.int32()))))
    ticks = rows["tick"].to_numpy()
    gaps = np.flatnonzero(np.diff(ticks) != 1) + 1
    cuts = sorted({*range(0, len(ticks), _BLOCK_TICKS), *gaps.tolist(), len(ticks)})
    try:
        told = [event for event in _events(folder, kept) if (event.tick, line(event)) not in there.lines]
        for number, (begin, end) in enumerate(pairwise(cuts)):
            up_to = ticks[end - 1] if end < len(ticks) else np.inf
            now = tuple(event for event in told if event.tick <= up_to)
            told = [event for event in told if event.tick > up_to]
            yield inbound.check(_block(number, rows.slice(begin, end - begin), now), uavs)
    except (MessageRejected, ValueError, TypeError, KeyError) as error:
        raise BadInput(f"{folder}: time series or events are damaged ({error})") from error


def _events(folder: Path, kept: Past) -> Iterator[Event]:
    with (folder / EVENTS).open("rb") as file:
        for text in file.read(kept.events_bytes).splitlines():
            row = json.loads(text)
            yield Event(int(row["tick"]), str(row["kind"]), str(row["text"]), tuple(map(int, row["uavs"])))


def _block(number: int, rows: pa.Table, events: tuple[Event, ...]) -> Telemetry:
    told = rows.filter(pc.is_valid(rows["leader_model"]))
    reports = told["leader_model"].to_pylist()
    return Telemetry(
        run=0,
        block=number,
        first_tick=rows["tick"][0].as_py(),
        states=states_of(rows),
        accelerations=per_uav(rows, "ax_m_s2", "ay_m_s2"),
        diagnostics=per_uav(rows, *DIAGNOSTICS),
        status=per_uav(rows, "status")[..., 0],
        energy=per_uav(rows, "energy_J")[..., 0],
        swarm=np.stack([rows[name].to_numpy() for name in SWARM_COLUMNS], axis=-1),
        links=np.zeros((0, 5), dtype=np.int32),
        report_ticks=told["tick"].to_numpy(),
        reports=np.array(reports, dtype=np.float32).reshape(-1, MODEL_FLOATS),
        spread=told["weight_spread"].to_numpy(),
        events=events,
    )
