"""Base class of channels, which decide how long a message takes and whether it is lost; checks of their results."""

import math
from abc import abstractmethod
from typing import Any, ClassVar, NamedTuple, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.swarm.errors import FAILURES, RunFailed, last_line
from meanflock.swarm.plugins.guard import check_array, check_same_form, check_values
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats, Vectors

MOST_SLOTS = 1_000_000  # limit of the slots of a message

Memory: TypeAlias = dict[str, NDArray[Any]]
Carried: TypeAlias = tuple[NDArray[np.int64], NDArray[np.bool_]]  # slots (K,) and whether delivered (K,)


class Message(NamedTuple):
    """All frames of one kind that UAVs send in a tick, and their K ≥ 1 links, sorted by source and then by target.

    The uploads of a round are one Message, for example, and so are the states that all UAVs broadcast in a tick.

    tick: in which they are sent. bits: size of each frame. source, target: (K,) the UAVs at the ends of each link; the
    leader is one of the UAVs. A pair comes several times if models are sent in fragments: once for each fragment.
    distance_m: (K,) lengths of the links. position_m: (N, 2) of all UAVs, m.
    """

    tick: int
    bits: int
    source: NDArray[np.intp]
    target: NDArray[np.intp]
    distance_m: Floats
    position_m: Vectors


class Channel:
    """Base class of channels. Derive from it and set `name`, which `radio.model` then refers to.

    Write `transmit` if the fate of each frame is drawn afresh. Write `init` and `carry` if the channel must know which
    UAVs talk, where they are, or what was drawn before. A channel must not remember anything else between two calls,
    and must draw from the given generator only. Then flights are bit-identical in every mode, and after every resume.
    """

    plugin_kind: ClassVar = "channel"
    name: ClassVar[str] = ""

    class Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
        """Keys of `[radio.options]`, with units and bounds."""

    def __init_subclass__(cls, **named: Any) -> None:
        super().__init_subclass__(**named)
        if cls.carry is not Channel.carry and cls.transmit is Channel.transmit:
            cls.transmit = _not_written  # type: ignore[method-assign, assignment]  # `carry` does all

    def __init__(self, options: "Channel.Options", scenario: Scenario) -> None:
        """`scenario`: its table `radio`, and whatever else the channel needs."""
        self.options, self.scenario = options, scenario

    def init(self, uavs: int) -> Memory:
        """Returns the memory at take-off: arrays that checkpoints keep, of any shape. Empty by default."""
        return {}

    def carry(
        self, memory: Memory, message: Message, rng: np.random.Generator
    ) -> tuple[Memory, NDArray[np.int64], NDArray[np.bool_]]:
        """Decides the fate of all frames of a `Message`; by default by `transmit`.

        Args:
            memory: the result of `init` or of the last call. Its arrays are read-only: return new ones, with the
                same names, dtypes and shapes.

        Returns:
            The new memory; the slots (K,) and deliveries (K,), see `transmit`.
        """
        answer = self.transmit(message.distance_m, message.bits, rng)
        slots, delivered = check_values("transmit", answer, 2, "slots and delivered")
        return memory, slots, delivered

    @abstractmethod
    def transmit(self, distance_m: Floats, bits: int, rng: np.random.Generator) -> Carried:
        """Decides the fate of frames of `bits` each on K ≥ 1 links, sorted by source and then by target.

        Args:
            distance_m: (K,) lengths of the links. bits: size of each frame.

        Returns:
            The slots of θ that the frame takes on each link (K,), 1 … 1,000,000, and whether the link delivers it (K,).
            Uploads are averaged D_M slots after they are sent, rounded up to whole ticks, or at `federation.deadline`.
        """
        raise NotImplementedError

    def expected(self, distance_m: Floats, bits: int) -> tuple[float, float] | None:
        """Closed forms of outages and latency, each summed over the links `distance_m` (K,).

        Returns:
            Expected outages, and expected slots of delivered messages (Σ E[D_m; delivered]); None (the default) if
            unknown.
        """
        return None

    def least_slots(self, bits: int) -> int | None:
        """Least number of slots that a message of `bits` takes; None (the default) if unknown."""
        return None


def _not_written(*_: Any) -> Carried:
    raise NotImplementedError("this channel has `carry` in place of `transmit`")


def carried(answer: Any, memory: Memory, links: int) -> tuple[Memory, NDArray[np.int64], NDArray[np.bool_]]:
    """Check what `carry` returned for so many links: the `memory` with the same form, slots and delivered.

    Raises:
        TypeError, ValueError: it is something else.
    """
    after, slots, delivered = check_values("carry", answer, 3, "memory, slots and delivered")
    check_same_form("memory", after, memory)
    check_array("slots", slots, (links,), np.int64)
    check_array("delivered", delivered, (links,), np.bool_)
    least, most = (np.minimum.reduce(slots), np.maximum.reduce(slots)) if links else (1, 1)
    if least < 1 or most > MOST_SLOTS:
        raise ValueError(f"slots from {least} to {most}; a message takes 1 to {MOST_SLOTS}")
    return after, slots, delivered


def failed(model: str, error: BaseException) -> RunFailed:
    """The error of a channel that raised, or returned something else than it must."""
    return RunFailed(f"channel {model!r}: failed: {last_line(error)}")


def closed_form(answer: Any) -> tuple[float, float] | None:
    """Check what `expected` returned: outages and slots, or None where these are unknown.

    Raises:
        ValueError: it is something else.
    """
    if answer is None:
        return None
    try:
        outages, slots = map(float, answer)
    except FAILURES:
        outages = slots = math.nan
    if not math.isfinite(outages + slots):
        raise ValueError(f"`expected` returns {answer!r}; expected two finite numbers, or None where unknown")
    return outages, slots
