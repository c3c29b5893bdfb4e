"""The suite for channels rejects each kind of mistake with its name."""

from typing import Any

import numpy as np
import pytest

from meanflock.channel.base import Channel
from meanflock.testing import ConformanceError, check_channel
from tests.testing.good import GoodChannel, calls, changed


def fades_slowly(self: Any, answer: Any, *_: Any) -> Any:
    """Remembers the fading of its links, and forgets it when their number changes."""
    slots, delivered = answer
    last = getattr(self, "last", delivered)
    self.last = delivered & last if len(last) == len(slots) else delivered
    return slots, self.last


def depends_on_motion(self: Any, answer: Any, distance_m: Any, *_: Any) -> Any:
    """Remembers the distances, which shows once they change."""
    slots, delivered = answer
    last, self.last = getattr(self, "last", distance_m), distance_m
    return slots + (len(last) == len(slots) and not np.array_equal(last, distance_m)), delivered


def expects_what_it_has_seen(self: Any, _answer: Any, *_: Any) -> Any:
    seen = float(calls(self))
    return seen, seen


def writes_to_the_distances(_self: Any, answer: Any, distance_m: Any, *_: Any) -> Any:
    distance_m *= 2.0
    return answer


class SpawnsGenerators(GoodChannel):
    """The number of generators that were spawned is in no checkpoint."""

    def transmit(self, distance_m: Any, bits: int, rng: np.random.Generator) -> tuple[Any, Any]:
        (child,) = rng.spawn(1)
        return super().transmit(distance_m, bits, child)


SpawnsGenerators.__name__ = "Wrong"


def changed_slots(change: Any) -> Any:
    """A channel whose slots are `change(slots, delivered)`."""
    return changed(GoodChannel, "transmit", lambda _self, answer, *_: (change(*answer), answer[1]))


def expecting(value: Any) -> Any:
    return type("Wrong", (GoodChannel,), {"expected": lambda *_: value})


def transmitting(change: Any) -> Any:
    return changed(GoodChannel, "transmit", change)


REMEMBERS = "go on from a checkpoint differ; keep nothing between two calls"
WRONG: dict[str, tuple[Any, str]] = {
    "fades slowly": (transmitting(fades_slowly), REMEMBERS),
    "depends on motion": (transmitting(depends_on_motion), REMEMBERS),
    "expects what it has seen": (changed(GoodChannel, "expected", expects_what_it_has_seen), REMEMBERS),
    "spawns generators": (SpawnsGenerators, f"{REMEMBERS}, and of `rng` take numbers only"),
    "writes to the distances": (transmitting(writes_to_the_distances), "writes to the distances; copy before you"),
    "a column of slots": (
        changed_slots(lambda slots, _: slots[:, None]),
        r"slots: int64 \(40, 1\), expected int64 \(40,\); return that",
    ),
    "slots of 32 bits": (
        changed_slots(lambda slots, _: slots.astype(np.int32)),
        r"slots: int32 \(40,\), expected int64 \(40,\); return that",
    ),
    "a list": (changed_slots(lambda slots, _: slots.tolist()), r"slots: a list, expected int64 \(40,\); return that"),
    "messages of no time": (
        changed_slots(lambda slots, delivered: np.where(delivered, slots, 0)),
        r"slots from 0 to \d; a message takes 1 to 1000000",
    ),
    "messages without end": (
        changed_slots(lambda slots, _: slots * 1_000_000),
        r"slots from \d+ to \d+; a message takes 1 to 1000000",
    ),
    "expects no number": (
        expecting((float("nan"), 1.0)),
        r"`expected` returns \(nan, 1.0\); expected two finite numbers, or None",
    ),
    "expects one number": (expecting(1.0), "`expected` returns 1.0; expected two finite numbers, or None"),
    "needs a link": (
        transmitting(lambda _self, answer, distance_m, *_: distance_m[0] >= 0 and answer),
        "`transmit` failed: IndexError.*; 0 links must do, as any number",
    ),
}


@pytest.mark.parametrize(("wrong", "expected"), WRONG.values(), ids=WRONG)
def test_a_wrong_channel_is_rejected_with_its_mistake(wrong: type[Channel], expected: str) -> None:
    with pytest.raises(ConformanceError, match=f"^Wrong: .*{expected}"):
        check_channel(wrong)
