"""The page that describes the wire: its dumps are the bytes of today, and its tables are those of the code."""

import re
import struct
from pathlib import Path

import msgspec
import numpy as np
import pytest

from meanflock.kernels.wire import DTYPES
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.net import keys
from meanflock.swarm.wire import control, tick
from meanflock.swarm.wire.messages import Act, Event, FrameKind, Frames, Join, Ready, Refusal, Sense, Stop, Welcome

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
DUMP_LINE = re.compile(r" *(\d+)  ((?:[0-9a-f]{2} ?)+?)(?:  .*)?")


@pytest.mark.parametrize("name", DUMPS)
def test_the_page_dumps_the_bytes_that_are_sent(name: str) -> None:
    text = PAGE.read_text(encoding="utf-8")
    lines = text.partition(f"<!-- dump of {name} -->\n```text\n")[2].partition("\n```")[0].splitlines()
    raw = b""
    for line in lines:
        found = DUMP_LINE.fullmatch(line)
        assert found is not None, line
        assert int(found[1]) == len(raw)
        raw += bytes.fromhex(found[2])
    assert raw == DUMPS[name]


def test_the_page_names_every_type_of_number_kind_of_frame_and_reason_of_a_reader() -> None:
    text = PAGE.read_text(encoding="utf-8")
    rows = [f"| {code} | `{name}` |" for code, name in enumerate(DTYPES)]
    rows += [f"| {kind.value} | {kind.name} |" for kind in FrameKind]
    rows += {f"`{reason}`" for reason in re.findall(r"`([a-z-]+)`", MessageRejected.__doc__ or "")} - {"`reason`"}
    rows.append(f'`zlib.crc32(b"test")` is `{RUN:#010x}`')  # a run's fingerprint, which its messages begin with
    assert [row for row in rows if row not in text] == []
    assert struct.pack(">I", RUN) in DUMPS["sense"]


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


def test_fields_with_a_default_may_be_left_out_from_the_end() -> None:
    join = control.decode(msgspec.msgpack.encode(["join", "agent", 1]))
    assert isinstance(join, Join)
    assert (join.role, join.rows, join.uav, join.token) == ("agent", 1, -1, 0)
    assert isinstance(control.decode(msgspec.msgpack.encode(["event", 3, "agent", "a word"])), Event)
