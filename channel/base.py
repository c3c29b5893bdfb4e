"""The channel door: what becomes of a message on each of some links."""

from abc import abstractmethod
from typing import ClassVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats


class Channel:
    """A model of links by radio. Derive from it, give it a `name`, and `radio.model` can name it.

    It keeps nothing between two calls, and draws from the generator it is given and no other: so a flight is the same
    in every mode and however often it was resumed.
    """

    door: ClassVar = "channel"
    name: ClassVar[str] = ""

    class Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
        """The keys of `[radio.options]`, with units and bounds."""

    def __init__(self, options: "Channel.Options", scenario: Scenario) -> None:
        """`scenario`: for its `radio` and whatever else the channel goes by."""
        self.options, self.scenario = options, scenario

    @abstractmethod
    def transmit(
        self, distance_m: Floats, bits: int, rng: np.random.Generator
    ) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Sends one message of `bits` over K ≥ 1 links, `distance_m` (K,), by source and then by target.

        Returns:
            Slots spent on each link (K,), 1 … 1,000,000 of θ each, and whether the message got through (K,). A round
            is closed D_M slots after its uploads are sent, so an upload that takes longer comes too late.
        """
        raise NotImplementedError

    def expected(self, distance_m: Floats, bits: int) -> tuple[float, float] | None:
        """Closed forms to stand beside what is observed, each summed over the links `distance_m` (K,).

        Returns:
            Outages, and slots of delivered messages (Σ E[D_m; delivered]); None where unknown, as by default.
        """
        return None

    def least_slots(self, bits: int) -> int | None:
        """Slots that a message of `bits` takes at best; None where unknown, as by default."""
        return None
