"""The page that describes the wire: its dumps are what is sent today, field by field, and its tables are the code's.

`python -m tests.swarm.test_wire_page` writes the dumps anew; do that only when the layout changes on purpose.
"""

import re
import struct
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
import pytest

from meanflock.kernels.wire import DTYPES, FIRST
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.net import keys
from meanflock.swarm.wire import control, tick
from meanflock.swarm.wire.messages import Act, Event, FrameKind, Frames, Join, Ready, Refusal, Sense, Stop, Welcome
from tests.swarm.backends import REFERENCE

PAGE = Path(__file__).parents[2] / "docs" / "wire.md"
RUN = keys.fingerprint("test")
STATE = np.array([[150.0, 100.0, -1.5, 0.25]])
RECEIVED = Frames(
    FrameKind.STATE, 0, np.array([0, 2], "<i4"), np.array([[151, 100, 0, 0], [150, 101, 0, 0]], "<f4"),
    np.array([[0, 1], [1, 1]], "<i4"),
)  # fmt: skip
DUMPS = {
    "sense": tick.write_sense(Sense(RUN, 41, STATE, True, False, (RECEIVED,))),
    "act": tick.write_act(
        Act(
            RUN,
            41,
            np.array([[-2.55, -2.075, 0.5]]),
            refused=np.array([2]),
            models=np.array([[1.0, -1.0]]),
            outbox=(Frames(FrameKind.STATE, 0, np.array([1], "<i4"), STATE.astype("<f4")),),
        )
    ),
}
WIDE = 16  # bytes in a line of a dump


def fields(raw: bytes) -> Iterator[tuple[int, str]]:
    """Sizes and meanings of the parts of a message, in order."""
    kind, run, number, flags, rows, columns, tables, batches = REFERENCE.read(raw)
    what = {1: "Sense", 2: "Act"}[kind]
    of_columns = {1: "x, y, vx, vy", 2: "acceleration x, y, diagnostics"}[kind]
    yield 1, f"array of {raw[0] & 0x0F}"
    yield 1, f"type: {what}"
    yield 5, f"run: {run:#010x}"
    yield 5, f"tick: {number}"
    yield 1, f"flags: {flags}" + (" (report)" if flags == tick.REPORT else "")
    yield 5, f"rows: {rows}"
    yield 1, f"columns: {columns}"
    yield 5, f"{8 * rows * columns} bytes follow"
    for row in np.frombuffer(raw, "<f8", rows * columns, FIRST).reshape(rows, columns).tolist():
        yield 8 * columns, f"{of_columns}: {', '.join(f'{value:g}' for value in row)}"
    names = {1: ("memory",), 2: ("lost", "refused", "models", "memory")}[kind]
    for name, at, size in zip(names, tables[::2], tables[1::2], strict=True):
        yield 5, f"{name}: {size} bytes follow"
        if size:
            dtype = "<f8" if name == "models" else "<i4"
            values = np.frombuffer(raw, dtype, size // np.dtype(dtype).itemsize, at)
            yield size, f"{name}: {', '.join(f'{value:g}' for value in values)}"
    yield 3, f"frames: {len(batches)} batch" + "es" * (len(batches) != 1)
    for of, number_, code, width, sources, source, payload, links, link in batches:
        yield 1, "array of 7"
        yield 1, f"kind: {FrameKind(of).name}"
        yield 5, f"number: {number_}"
        yield 1, f"dtype: {DTYPES[code]}"
        yield 5, f"width: {width}"
        yield 5, f"sources: {4 * sources} bytes follow"
        yield 4 * sources, f"UAV {', '.join(map(str, np.frombuffer(raw, '<i4', sources, source)))}"
        size = np.dtype(DTYPES[code]).itemsize * width
        yield 5, f"payload: {sources * size} bytes follow"
        for row in range(sources):
            values = np.frombuffer(raw, DTYPES[code], width, payload + row * size)
            yield size, f"payload: {', '.join(f'{value:g}' for value in values)}"
        yield 5, f"links: {8 * links} bytes follow"
        for pair in np.frombuffer(raw, "<i4", 2 * links, link).reshape(-1, 2).tolist():
            yield 8, f"link: row {pair[0]} of the payload to UAV {pair[1]}"


def dump(raw: bytes) -> str:
    """Offset, bytes and meaning, a field a line or more."""
    lines, at = [], 0
    for size, meaning in fields(raw):
        for begin in range(at, at + size, WIDE):
            part = raw[begin : min(begin + WIDE, at + size)].hex(" ")
            lines.append(f"{begin:5}  {part:{3 * WIDE - 1}}  {meaning if begin == at else ''}".rstrip())
        at += size
    assert at == len(raw)
    return "\n".join(lines)


def block(name: str) -> str:
    return f"<!-- dump of {name} -->\n```text\n{dump(DUMPS[name])}\n```\n<!-- end -->"


@pytest.mark.parametrize("name", DUMPS)
def test_the_page_dumps_what_is_sent(name: str) -> None:
    assert block(name) in PAGE.read_text(encoding="utf-8")


def test_the_page_names_every_type_of_number_and_every_kind_of_frame() -> None:
    text = PAGE.read_text(encoding="utf-8")
    for code, name in enumerate(DTYPES):
        assert f"| {code} | `{name}` |" in text
    for kind in FrameKind:
        assert f"| {kind.value} | {kind.name} |" in text


@pytest.mark.parametrize("kind", [Join, Welcome, Refusal, Ready, Stop, Event])
def test_the_page_has_the_fields_of_a_control_message_in_their_order(kind: type[msgspec.Struct]) -> None:
    row = next(
        line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith(f"| {kind.__name__} |")
    )
    config = kind.__struct_config__
    assert re.findall(r"`(\w+)`", row.split("|")[2]) == [config.tag, *kind.__struct_fields__]


def test_the_page_s_example_of_an_array_is_one() -> None:
    text = PAGE.read_text(encoding="utf-8")
    head, numbers = re.search(
        r"`((?:[0-9a-f]{2} ){9}[0-9a-f]{2})` and the numbers\s+`((?:[0-9a-f]{2} ?)+)`", text
    ).groups()  # type: ignore[union-attr]
    raw = bytes.fromhex(head + numbers)
    message = msgspec.msgpack.encode(["welcome", 1, "agent-0", [0], 0, b"{}", msgspec.msgpack.Ext(1, raw)])
    welcome = control.decode(message)
    assert isinstance(welcome, Welcome)
    np.testing.assert_array_equal(welcome.initial_states, np.array([[1.5, -2.0]], "<f4"))


def test_the_page_names_the_reasons_of_a_reader() -> None:
    text = PAGE.read_text(encoding="utf-8")
    for reason in re.findall(r"`([a-z-]+)`", MessageRejected.__doc__ or ""):
        assert reason == "reason" or f"`{reason}`" in text, reason


def test_the_page_s_fingerprint_is_that_of_the_run() -> None:
    assert f'`zlib.crc32(b"test")` is `{RUN:#010x}`' in PAGE.read_text(encoding="utf-8")
    assert struct.pack(">I", RUN) in DUMPS["sense"]


def test_fields_with_a_default_may_be_left_out_from_the_end() -> None:
    join = control.decode(msgspec.msgpack.encode(["join", "agent", 1]))
    assert isinstance(join, Join)
    assert (join.role, join.rows, join.uav, join.token) == ("agent", 1, -1, 0)
    assert isinstance(control.decode(msgspec.msgpack.encode(["event", 3, "agent", "a word"])), Event)


if __name__ == "__main__":
    page = PAGE.read_text(encoding="utf-8")
    for title in DUMPS:
        page = re.sub(rf"<!-- dump of {title} -->.*?<!-- end -->", lambda _, t=title: block(t), page, flags=re.S)
    PAGE.write_text(page, encoding="utf-8")
