"""Messages of a tick, of all shapes, and what docs/wire.md says of them, read without our code."""

import struct
from typing import Any

import numpy as np
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from meanflock.kernels.wire import DTYPES, SENSE
from meanflock.swarm.wire.messages import Act, FrameKind, Frames, Sense

QUICK = settings(
    max_examples=100, deadline=None, database=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
U32 = st.integers(0, 2**32 - 1)


def finite(name: str, shapes: st.SearchStrategy[Any]) -> st.SearchStrategy[np.ndarray]:
    """Arrays of a dtype and of some shapes."""
    dtype = np.dtype(name)
    numbers = st.floats(width=8 * dtype.itemsize, allow_nan=False, allow_infinity=False) if dtype.kind == "f" else None
    return hnp.arrays(dtype, shapes, elements=numbers)


def table(dtype: str, rows: st.SearchStrategy[int], columns: st.SearchStrategy[int]) -> st.SearchStrategy[np.ndarray]:
    return finite(dtype, st.tuples(rows, columns))


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
        refused_uploads=draw(uavs(st.integers(0, 4))),
        refused_states=draw(uavs(st.integers(0, 4))),
        waiting=draw(uavs(st.integers(0, 4))),
        models=draw(st.none() | models),
        memory=draw(st.binary(max_size=40)),
        outbox=draw(few),
    )


def array_of(dtype: str, raw: bytes, *shape: int) -> np.ndarray:
    """Numbers of a dtype by the standard library, without NumPy's reader."""
    letter = {"<f2": "e", "<f4": "f", "<f8": "d", "<i4": "i", "u1": "B", "<i2": "h", "i1": "b"}[dtype]
    numbers = struct.unpack(f"<{len(raw) // struct.calcsize(letter)}{letter}", raw)
    return np.array(numbers, dtype).reshape(shape or -1)


def as_documented(tree: list[Any]) -> Sense | Act:
    """The message in what some library unpacked, read as docs/wire.md says and not by our reader."""
    kind, run, number, flags, rows, columns, first, *rest = tree
    table_, frames = array_of("<f8", first, rows, columns), []
    for label, round_, code, width, source, said, links in rest.pop():
        dtype, count = DTYPES[code], len(source) // 4
        pairs = array_of("<i4", links, len(links) // 8, 2) if links else None
        payload = array_of(dtype, said, count, width)
        frames.append(Frames(FrameKind(label), round_, array_of("<i4", source), payload, pairs))
    if kind == SENSE:
        return Sense(run, number, table_, bool(flags & 1), bool(flags & 2), tuple(frames), *rest)
    *named, models, memory = rest
    lost, uploads, states, waiting = (array_of("<i4", uavs) for uavs in named)
    assert flags == 0
    learned = array_of("<f8", models, rows, len(models) // (8 * rows)) if models else None
    return Act(run, number, table_, lost, uploads, states, waiting, learned, memory, tuple(frames))
