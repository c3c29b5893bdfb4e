"""Base class of channels, which decide how long a message takes on a link and whether it is lost."""

from abc import abstractmethod
from typing import ClassVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats


class Channel:
    """Base class of channels. Derive from it and set `name`, which `radio.model` then refers to.

    A channel must not remember anything between two calls, and must draw from the given generator only. Then a flight
    is the same in every mode, and after every resume.
    """

    door: ClassVar = "channel"
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
        """Closed forms of what is observed, each summed over the links `distance_m` (K,).

        Returns:
            Expected outages, and expected slots of delivered messages (Σ E[D_m; delivered]); None (the default) if
            unknown.
        """
        return None

    def least_slots(self, bits: int) -> int | None:
        """Least number of slots that a message of `bits` takes; None (the default) if unknown."""
        return None
