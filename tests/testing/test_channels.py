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
        (KeepsItElsewhere, "made anew differ", "keep nothing between two calls"),
        (WritesToTheDistances, "writes to the distances", "copy before you write"),
        (OfAnotherShape, "returns shapes", r"return slots \(K,\)"),
        (OfAnotherType, "returns float64 and bool", "slots as int64"),
        (TakesNoTime, "no slot at all", "one slot at least"),
        (ReturnsTheSlots, "`transmit` returns a ndarray", "return slots and delivered"),
        (TakesForEver, r"a message takes \d+ slots", "at most 1000000"),
        (ExpectsNoNumber, r"`expected` returns \(nan, 1.0\)", "return outages and slots"),
        (ExpectsOne, "`expected` returns 1.0", "return outages and slots"),
        (NeedsALink, "over 0 links failed: IndexError", "any number of links must do"),
    ],
)
def test_a_wrong_one_is_told_what_to_mend(wrong: type[Channel], says: str, mend: str) -> None:
    with pytest.raises(ConformanceError, match=rf"^{wrong.__name__}: .*{says}.*; .*{mend}"):
        check_channel(wrong)


class Slow(Good):
    def transmit(self, distance_m, bits, rng):  # type: ignore[no-untyped-def]
        end = time.perf_counter() + 0.004
        while time.perf_counter() < end:
            pass
        return super().transmit(distance_m, bits, rng)


def test_a_slow_one_is_told_how_slow() -> None:
    with pytest.raises(
        ConformanceError,
        match=r"^Slow: a message over 600 links takes \d+ ms; make it quicker, or pass a larger `slow_ms`",
    ):
        check_channel(Slow, slow_ms=3.0)
