"""An example of every message, and its golden bytes.

`python -m tests.swarm.examples` writes the golden files anew; do that only when a message changes on purpose.
"""

import typing
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from meanflock.kernels.wire import SENSE
from meanflock.net import tick
from meanflock.swarm.events import Collided, RoundEnded
from meanflock.swarm.wire import control, messages
from meanflock.swarm.wire.messages import Act, FrameKind, Frames, Sense

GOLDEN = Path(__file__).parents[1] / "golden"
TYPES: tuple[type, ...] = typing.get_args(messages.Message)  # of control messages; those of a tick are Sense and Act
DTYPES = ("<f2", "<f4", "<f8", "<i4", "u1", "<i2", "i1", "<i8", "?")


def same(one: Any, other: Any) -> None:
    """Equal to the last bit: types, dtypes, shapes, values."""
    assert type(one) is type(other)
    if isinstance(one, msgspec.Struct):
        for name in one.__struct_fields__:
            same(getattr(one, name), getattr(other, name))
    elif isinstance(one, tuple):
        assert len(one) == len(other)
        for a, b in zip(one, other, strict=True):
            same(a, b)
    elif isinstance(one, np.ndarray):
        assert (one.dtype, one.shape, one.tobytes()) == (other.dtype, other.shape, other.tobytes())
    else:
        assert one == other


def arrays_in(value: Any) -> list[np.ndarray]:
    if isinstance(value, np.ndarray):
        return [value]
    if isinstance(value, msgspec.Struct):
        value = tuple(getattr(value, name) for name in value.__struct_fields__)
    return [array for part in value for array in arrays_in(part)] if isinstance(value, tuple) else []


def numbers(dtype: str, *shape: int) -> np.ndarray:
    """A table that is easy to recognise in a hex dump."""
    count = int(np.prod(shape))
    return (np.arange(count) - count // 2).reshape(shape).astype(dtype)


FRAMES = Frames(FrameKind.UPLOAD, 3, numbers("<i4", 2) + 4, numbers("<f4", 2, 5) / 2)
DELIVERED = Frames(FrameKind.STATE, 0, numbers("<i4", 1), numbers("<f2", 1, 4), np.array([[0, 1], [0, 2]], dtype="<i4"))
EXAMPLES: dict[str, Any] = {
    "join": messages.Join("agent", 5, 20),
    "welcome": messages.Welcome(
        run=0xDEADBEEF,
        node="agent-5",
        uavs=(5, 6, 300),
        tick=70000,
        scenario=b'{"uavs":301}',
        initial_states=numbers("<f4", 3, 4) + 0.25,
        memory=control.encode_record({"weights": numbers("<f8", 3, 2) / 9, "uav": numbers("<i8", 3)}),
        plugins=(("controller", "spring", "sha256 0123"), ("aggregator", "fedavg", "meanflock 1.0")),
    ),
    "refusal": messages.Refusal("every UAV of this run has its agent already – größer"),
    "ready": messages.Ready(0xDEADBEEF),
    "sense": Sense(0xDEADBEEF, 99, numbers("<f8", 2, 4) / 3, True, False, (FRAMES, DELIVERED), b"\x80"),
    "act": Act(
        run=0xDEADBEEF,
        tick=99,
        commands=numbers("<f8", 2, 5) / 7,
        lost=np.array([6], dtype="<i4"),
        refused_uploads=np.array([5], dtype="<i4"),
        refused_states=np.array([1, 300], dtype="<i4"),
        waiting=np.array([5, 6], dtype="<i4"),
        models=numbers("<f8", 2, 246) / 9,
        memory=control.encode_record({"weights": numbers("<f8", 2, 3)}),
        outbox=(FRAMES,),
    ),
    "stop": messages.Stop(0xDEADBEEF, "finished"),
    "event": messages.Event(12, "collision", "UAV 1 and UAV 2 collided", (1, 2)),
    "telemetry": messages.Telemetry(
        run=0xDEADBEEF,
        block=7,
        first_tick=140,
        states=numbers("<f8", 2, 3, 4) / 3,
        accelerations=numbers("<f4", 2, 3, 2) / 7,
        diagnostics=numbers("<f4", 2, 3, 3) / 7,
        status=numbers("u1", 2, 3) % 3,
        energy=numbers("<f4", 2, 3),
        swarm=numbers("<f8", 2, 12),
        links=numbers("<i4", 2, 7),
        report_ticks=numbers("<i4", 1),
        reports=numbers("<f4", 1, 246),
        spread=numbers("<f8", 1) + 0.5,
        events=(
            Collided(141, 1, 2),
            RoundEnded(141, 1, 140, "averaged", sent=(0, 2), received=(2,), diagnostics={"error": 0.5}),
        ),
        checkpoint=b"\x93\x01\x02\x03",
        diagnostic_names=("hjb_residual", "fpk_residual", "phi_G"),
        has_diagnostic=np.array([[1, 1, 0]] * 3, dtype=np.uint8),
    ),
    "received": messages.Acknowledgement(0xDEADBEEF, 7),
    "finished": messages.Finished(0xDEADBEEF, 88, b'{"schema":1}'),
}
OF_A_TICK = ("sense", "act")


def written(message: Any) -> bytes:
    if isinstance(message, Sense):
        return tick.write_sense(message)
    return tick.write_act(message) if isinstance(message, Act) else control.encode(message)


def read(raw: bytes) -> Any:
    if raw[1:2] not in tick.TYPES:
        return control.decode(raw)
    return tick.read_sense(raw) if raw[1] == SENSE else tick.read_act(raw)


RAW = {name: written(message) for name, message in EXAMPLES.items()}


if __name__ == "__main__":
    GOLDEN.mkdir(exist_ok=True)
    for title, raw_bytes in RAW.items():
        (GOLDEN / f"{title}.bin").write_bytes(raw_bytes)
