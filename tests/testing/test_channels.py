"""The suite for channels lets ours through, and says of every kind of wrong one what to mend."""

import time

import numpy as np
import pytest

from meanflock.channel.base import Channel
from meanflock.swarm import plugins
from meanflock.testing import ConformanceError, check_channel


@pytest.mark.parametrize("name", plugins.names("channel"))
def test_every_channel_of_ours_conforms(name: str) -> None:
    check_channel(plugins.load("channel", name))


class Good(Channel):
    """Loses a message in five and takes up to four slots, from which the wrong ones are made."""

    name = "good"

    def transmit(self, distance_m, bits, rng):  # type: ignore[no-untyped-def]
        return rng.integers(1, 5, len(distance_m)), rng.random(len(distance_m)) < 0.8


def test_a_good_one_conforms() -> None:
    check_channel(Good)


class DrawsItsOwn(Good):
    def transmit(self, distance_m, bits, rng):  # type: ignore[no-untyped-def]
        slots, delivered = super().transmit(distance_m, bits, rng)
        return slots, delivered & (np.random.random(len(slots)) < 0.5)  # noqa: NPY002  # that is what is wrong with it


class KeepsItElsewhere(Good):
    def transmit(self, distance_m, bits, rng):  # type: ignore[no-untyped-def]
        self.sent = getattr(self, "sent", 0) + 1
        slots, delivered = super().transmit(distance_m, bits, rng)
        return slots + self.sent, delivered


class FadesSlowly(Good):
    """Remembers the fading of its links, and forgets it whenever it carries another number of them."""

    def transmit(self, distance_m, bits, rng):  # type: ignore[no-untyped-def]
        slots, delivered = super().transmit(distance_m, bits, rng)
        last = getattr(self, "last", delivered)
        self.last = delivered & last if len(last) == len(slots) else delivered
        return slots, self.last


class GoesByTheMotion(Good):
    """Remembers where the links were, which shows once they have moved."""

    def transmit(self, distance_m, bits, rng):  # type: ignore[no-untyped-def]
        slots, delivered = super().transmit(distance_m, bits, rng)
        last, self.last = getattr(self, "last", distance_m), distance_m
        return slots + (len(last) == len(slots) and not np.array_equal(last, distance_m)), delivered


class ExpectsWhatItHasSeen(Good):
    def expected(self, distance_m, bits):  # type: ignore[no-untyped-def]
        self.seen = getattr(self, "seen", 0.0) + len(distance_m)
        return self.seen, self.seen


class WritesToTheDistances(Good):
    def transmit(self, distance_m, bits, rng):  # type: ignore[no-untyped-def]
        distance_m *= 2.0
        return super().transmit(distance_m, bits, rng)


class OfAnotherShape(Good):
    def transmit(self, distance_m, bits, rng):  # type: ignore[no-untyped-def]
        slots, delivered = super().transmit(distance_m, bits, rng)
        return slots[:, None], delivered


class OfAnotherType(Good):
    def transmit(self, distance_m, bits, rng):  # type: ignore[no-untyped-def]
        slots, delivered = super().transmit(distance_m, bits, rng)
        return slots.astype(float), delivered


class OfNarrowerNumbers(Good):
    def transmit(self, distance_m, bits, rng):  # type: ignore[no-untyped-def]
        slots, delivered = super().transmit(distance_m, bits, rng)
        return slots.astype(np.int32), delivered


class Lists(Good):
    def transmit(self, distance_m, bits, rng):  # type: ignore[no-untyped-def]
        slots, delivered = super().transmit(distance_m, bits, rng)
        return slots.tolist(), delivered.tolist()


class SpawnsGenerators(Good):
    def transmit(self, distance_m, bits, rng):  # type: ignore[no-untyped-def]
        (child,) = rng.spawn(1)  # how many there were is in no checkpoint
        return super().transmit(distance_m, bits, child)


class TakesNoTime(Good):
    def transmit(self, distance_m, bits, rng):  # type: ignore[no-untyped-def]
        slots, delivered = super().transmit(distance_m, bits, rng)
        return np.where(delivered, slots, 0), delivered


class ReturnsTheSlots(Good):
    def transmit(self, distance_m, bits, rng):  # type: ignore[no-untyped-def]
        return np.ones(len(distance_m), dtype=np.int64)


class TakesForEver(Good):
    def transmit(self, distance_m, bits, rng):  # type: ignore[no-untyped-def]
        slots, delivered = super().transmit(distance_m, bits, rng)
        return slots * 1_000_000, delivered


class ExpectsNoNumber(Good):
    def expected(self, distance_m, bits):  # type: ignore[no-untyped-def]
        return float("nan"), 1.0


class ExpectsOne(Good):
    def expected(self, distance_m, bits):  # type: ignore[no-untyped-def]
        return 1.0


class NeedsALink(Good):
    def transmit(self, distance_m, bits, rng):  # type: ignore[no-untyped-def]
        assert distance_m[0] >= 0
        return super().transmit(distance_m, bits, rng)


@pytest.mark.parametrize(
    ("wrong", "says", "mend"),
    [
        (DrawsItsOwn, "otherwise a second time", "draw from the generator you are given"),
        (KeepsItElsewhere, "go on from a checkpoint differ", "keep nothing between two calls"),
        (FadesSlowly, "go on from a checkpoint differ", "keep nothing between two calls"),
        (GoesByTheMotion, "go on from a checkpoint differ", "keep nothing between two calls"),
        (ExpectsWhatItHasSeen, "go on from a checkpoint differ", "keep nothing between two calls"),
        (SpawnsGenerators, "go on from a checkpoint differ", "of `rng` take numbers only"),
        (WritesToTheDistances, "writes to the distances", "copy before you write"),
        (OfAnotherShape, r"slots: int64 \(40, 1\), expected int64 \(40,\)", "return that"),
        (OfAnotherType, r"slots: float64 \(40,\), expected int64", "return that"),
        (OfNarrowerNumbers, r"slots: int32 \(40,\), expected int64", "return that"),
        (Lists, r"slots: a list, expected int64 \(40,\)", "return that"),
        (TakesNoTime, r"slots from 0 to \d", "a message takes 1 to 1000000"),
        (ReturnsTheSlots, "`transmit` returns a ndarray", "expected slots and delivered"),
        (TakesForEver, r"slots from \d+ to \d+", "a message takes 1 to 1000000"),
        (ExpectsNoNumber, r"`expected` returns \(nan, 1.0\)", "expected two finite numbers, or None"),
        (ExpectsOne, "`expected` returns 1.0", "expected two finite numbers, or None"),
        (NeedsALink, "`transmit` failed: IndexError", "0 links must do, as any number"),
    ],
)
def test_a_wrong_one_is_told_what_to_mend(wrong: type[Channel], says: str, mend: str) -> None:
    with pytest.raises(ConformanceError, match=rf"^{wrong.__name__}: .*{says}.*; .*{mend}"):
        check_channel(wrong)


class Slow(Good):
    def transmit(self, distance_m, bits, rng):  # type: ignore[no-untyped-def]
        time.sleep(0.004)
        return super().transmit(distance_m, bits, rng)


def test_a_slow_one_is_told_how_slow() -> None:
    with pytest.raises(
        ConformanceError,
        match=r"^Slow: a message over 600 links takes \d+ ms; make it quicker, or pass a larger `slow_ms`",
    ):
        check_channel(Slow, slow_ms=3.0)
