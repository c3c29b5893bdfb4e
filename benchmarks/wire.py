"""Bytes of a model on the wire, and time of coding a message."""

from collections.abc import Callable
from functools import partial
from typing import Any

import msgpack

from benchmarks import sizes
from benchmarks.figure import Effort, Figure, Outcome, Say, in_turns, per_call_ms
from meanflock.net import tick
from meanflock.swarm.wire.messages import Act, Frames, Sense

TITLE = "Bytes and codec"
ABOUT = (
    "Wire bytes of an upload: by how much an Act with the model is longer than one without. Codec times are of whole "
    "messages, typed, with shapes and finiteness checked; the floor is msgpack on the same structure with its "
    "arrays as ready byte strings, unchecked."
)
PAYLOAD_TARGET = 1.10


def run(effort: Effort, say: Say) -> Outcome:
    """Sizes for H, F and HF, then times."""
    outcome = Outcome()
    for method in ("mfgfl-h", "mfgfl-f", "mfgfl-hf"):
        frames = sizes.upload(method)
        wire = sizes.size(sizes.act((frames,))) - sizes.size(sizes.act())
        payload = Figure(f"payload of an upload, {method}", "B", [float(frames.payload.nbytes)], "neither")
        name = f"wire bytes of an upload, {method}"
        outcome.figures += [Figure(name, "B", [float(wire)], floor=payload, ratio_target=PAYLOAD_TARGET), payload]
    messages: dict[str, Sense | Act] = {
        "Sense": sizes.sense(),
        "Act": sizes.act(),
        "Act with a model": sizes.act((sizes.upload("mfgfl-hf"),)),
    }
    for name, message in messages.items():
        say(name)
        outcome.figures += _times(name, message, effort)
    return outcome


def _times(name: str, message: Sense | Act, effort: Effort) -> list[Figure]:
    count, repeats = effort.choose(2000, 200), effort.choose(15, 5)
    write: Callable[[Any], bytes] = tick.write_sense if isinstance(message, Sense) else tick.write_act
    read: Callable[[bytes], Any] = tick.read_sense if isinstance(message, Sense) else tick.read_act
    raw, plain = write(message), _plain(message)
    work: dict[str, Callable[[], Any]] = {
        "encode": partial(write, message),
        "decode": partial(read, raw),
        "pack": partial(msgpack.packb, plain),
        "unpack": partial(msgpack.unpackb, msgpack.packb(plain)),
    }
    us = in_turns(repeats, {key: lambda call=call: 1e3 * per_call_ms(call, count) for key, call in work.items()})
    pack, unpack = (Figure(f"msgpack {key}, {name}", "µs", us[key]) for key in ("pack", "unpack"))
    encode = Figure(f"encode, {name}", "µs", us["encode"], floor=pack)
    return [encode, pack, Figure(f"decode, {name}", "µs", us["decode"], floor=unpack), unpack]


def _plain(message: Sense | Act) -> list[Any]:
    """The same fields as lists and byte strings."""

    def plain(value: Any) -> Any:
        if isinstance(value, Sense | Act | Frames):
            return [plain(getattr(value, name)) for name in value.__struct_fields__]
        if isinstance(value, tuple):
            return [plain(item) for item in value]
        return value.tobytes() if hasattr(value, "tobytes") else value

    return [type(message).__name__.lower(), *plain(message)]
