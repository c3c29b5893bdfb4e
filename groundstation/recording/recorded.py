"""What recordings of a run hold, read back from their files."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rerun.chunk import RrdReader

from meanflock.groundstation.recording import blueprint as look
from meanflock.groundstation.recording import panels
from meanflock.swarm.printable import printable
from meanflock.swarm.wire.messages import Event


@dataclass(frozen=True)
class Recorded:
    """What is in recordings of a run: ticks (R,) of which they have everything, and lines of the log with theirs."""

    ticks: NDArray[np.int64]
    lines: set[tuple[int, str]]


def recorded(parts: Iterable[Path]) -> Recorded:
    """Reads what recordings hold; they are whole, or were repaired."""
    ticks: list[int] = []
    lines: set[tuple[int, str]] = set()
    for part in parts:
        ticks += [tick for tick, _ in _rows(part, panels.LAST.entity, "Scalars:scalars")]
        lines |= {(tick, text[0]) for tick, text in _rows(part, look.EVENTS, "TextLog:text")}
    return Recorded(np.unique(np.array(ticks, dtype=np.int64)), lines)


def _rows(path: Path, entity: str, component: str) -> Iterator[tuple[int, Any]]:
    for chunk in RrdReader(path).stream().filter(content=f"/{entity}"):
        batch = chunk.to_record_batch()
        if {look.TICKS, component} <= set(batch.schema.names):
            yield from zip(batch.column(look.TICKS).to_pylist(), batch.column(component).to_pylist(), strict=True)


def line(event: Event) -> str:
    """An event as the log of a recording shows it."""
    return printable(event.text if event.kind in event.text else f"{event.kind}: {event.text}")
