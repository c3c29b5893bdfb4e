"""Messages of a tick, of all shapes, and what docs/wire.md says of them, read without our code."""

import struct
from typing import Any

import numpy as np
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from meanflock.kernels.wire import ACT, DTYPES, SENSE
from meanflock.swarm.wire import tick
from meanflock.swarm.wire.messages import Act, FrameKind, Frames, Sense

QUICK = settings(
    max_examples=100, deadline=None, database=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
U32 = st.integers(0, 2**32 - 1)


def table(dtype: str, rows: st.SearchStrategy[int], columns: st.SearchStrategy[int]) -> st.SearchStrategy[np.ndarray]:
    """Finite numbers in two axes."""
    kind = np.dtype(dtype)
    numbers = None
    if kind.kind == "f":
        numbers = st.floats(width=8 * kind.itemsize, allow_nan=False, allow_infinity=False)  # type: ignore[call-overload]
    return hnp.arrays(kind, st.tuples(rows, columns), elements=numbers)


def uavs(size: st.SearchStrategy[int]) -> st.SearchStrategy[np.ndarray]:
    return hnp.arrays(np.dtype("<i4"), size)


@st.composite
def batches(draw: st.DrawFn) -> Frames:
    """Frames of any kind, number, dtype and width; of no UAV, and of no width, too."""
    sources = draw(st.integers(0, 5))
    said = draw(table(draw(st.sampled_from(DTYPES)), st.just(sources), st.integers(0, 9)))
    links = draw(st.none() | hnp.arrays(np.dtype("<i4"), st.tuples(st.integers(1, 6), st.just(2))))
    return Frames(draw(st.sampled_from(FrameKind)), draw(U32), draw(uavs(st.just(sources))), said, links)


few = st.lists(batches(), max_size=4).map(tuple)
senses = st.builds(
    Sense,
    run=U32,
    tick=U32,
    states=table("<f8", st.integers(0, 4), st.integers(0, 5)),
    report=st.booleans(),
    checkpoint=st.booleans(),
    inbox=few,
    memory=st.binary(max_size=40),
)


@st.composite
def acts(draw: st.DrawFn) -> Act:
    rows = draw(st.integers(0, 4))
    models = table("<f8", st.just(rows), st.integers(1, 7)) if rows else st.none()
    return Act(
        run=draw(U32),
        tick=draw(U32),
        commands=draw(table("<f8", st.just(rows), st.integers(0, 9))),
        lost=draw(uavs(st.integers(0, 4))),
        refused=draw(uavs(st.integers(0, 4))),
        models=draw(st.none() | models),
        memory=draw(st.binary(max_size=40)),
        outbox=draw(few),
    )


def written(message: Sense | Act) -> bytes:
    return tick.write_sense(message) if isinstance(message, Sense) else tick.write_act(message)


def read(raw: bytes) -> Sense | Act:
    """Whichever it says it is, as both receivers would take it."""
    return tick.read_act(raw) if raw[1:2] == bytes([ACT]) else tick.read_sense(raw)


def numbers_of(dtype: str, raw: bytes) -> list[Any]:
    """Numbers of a dtype, without NumPy."""
    letter, size = {"<f2": "e", "<f4": "f", "<f8": "d", "<i4": "i", "u1": "B", "<i2": "h", "i1": "b"}[dtype], 0
    size = struct.calcsize(f"<{letter}")
    assert len(raw) % size == 0
    return list(struct.unpack(f"<{len(raw) // size}{letter}", raw))


def as_documented(tree: list[Any]) -> dict[str, Any]:
    """The fields of a message that some library unpacked, as docs/wire.md describes them; not read by ours."""
    kind, run, number, flags, rows, columns, first, *rest = tree
    fields: dict[str, Any] = {"run": run, "tick": number, "table": (rows, columns, numbers_of("<f8", first))}
    if kind == SENSE:
        memory, frames = rest
        fields |= {"report": bool(flags & 1), "checkpoint": bool(flags & 2), "memory": memory}
    else:
        lost, refused, models, memory, frames = rest
        assert flags == 0
        fields |= {"lost": numbers_of("<i4", lost), "refused": numbers_of("<i4", refused), "memory": memory}
        fields["models"] = numbers_of("<f8", models)
    fields["frames"] = []
    for of, round_, code, width, source, said, links in frames:
        pairs = numbers_of("<i4", links)
        batch = [of, round_, DTYPES[code], width, numbers_of("<i4", source), numbers_of(DTYPES[code], said)]
        fields["frames"].append([*batch, list(zip(pairs[::2], pairs[1::2], strict=True))])
    return fields


def as_meant(message: Sense | Act) -> dict[str, Any]:
    """The same of a message as it is in memory."""
    first = message.states if isinstance(message, Sense) else message.commands
    fields: dict[str, Any] = {
        "run": message.run,
        "tick": message.tick,
        "table": (*first.shape, first.ravel().tolist()),
        "memory": message.memory,
        "frames": [],
    }
    if isinstance(message, Sense):
        fields |= {"report": message.report, "checkpoint": message.checkpoint}
    else:
        fields |= {"lost": message.lost.tolist(), "refused": message.refused.tolist()}
        fields["models"] = [] if message.models is None else message.models.ravel().tolist()
    for batch in message.inbox if isinstance(message, Sense) else message.outbox:
        dtype = next(name for name in DTYPES if np.dtype(name) == batch.payload.dtype)
        links = [] if batch.links is None else [tuple(pair) for pair in batch.links.tolist()]
        head = [int(batch.kind), batch.round, dtype, batch.payload.shape[1], batch.source.tolist()]
        fields["frames"].append([*head, batch.payload.ravel().tolist(), links])
    return fields
