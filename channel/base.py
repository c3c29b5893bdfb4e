"""Base class of channels, which decide how long a message takes and whether it is lost; checks of their results."""

import math
from abc import abstractmethod
from typing import Any, ClassVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.swarm.errors import FAILURES
from meanflock.swarm.plugins.guard import check_array, check_pair
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats

MOST_SLOTS = 1_000_000  # limit of the slots of a message


class Channel:
    """Base class of channels. Derive from it and set `name`, which `radio.model` then refers to.

    A channel must not remember anything between two calls, and must draw from the given generator only. Then a flight
    is the same in every mode, and after every resume.
    """

    plugin_kind: ClassVar = "channel"
    name: ClassVar[str] = ""

    class Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
        """Keys of `[radio.options]`, with units and bounds."""

    def __init__(self, options: "Channel.Options", scenario: Scenario) -> None:
        """`scenario`: its table `radio`, and whatever else the channel needs."""
        self.options, self.scenario = options, scenario

    @abstractmethod
    def transmit(
        self, distance_m: Floats, bits: int, rng: np.random.Generator
    ) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Sends one message of `bits` over K ≥ 1 links of lengths `distance_m` (K,), by source and then by target.

        Returns:
            The slots of θ that each link took (K,), 1 … 1,000,000, and whether it delivered the message (K,). A round
            closes D_M slots after its uploads are sent; an upload that takes longer is too late.
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


def carried(answer: Any, links: int) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Check what `transmit` returned for so many links: slots and delivered.

    Raises:
        TypeError, ValueError: it is something else.
    """
    slots, delivered = check_pair("transmit", answer, "slots and delivered")
    check_array("slots", slots, (links,), np.int64)
    check_array("delivered", delivered, (links,), np.bool_)
    least, most = (np.minimum.reduce(slots), np.maximum.reduce(slots)) if links else (1, 1)
    if least < 1 or most > MOST_SLOTS:
        raise ValueError(f"slots from {least} to {most}; a message takes 1 to {MOST_SLOTS}")
    return slots, delivered


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
