"""The SNR threshold at which a radio loses a wanted share of broadcast states, by the channel's closed form.

The outage of a cell is the probability that one broadcast of a state of 64 bits fails, mean over all pairs of UAVs at
their starts. It is set by `radio.target_snr_db`. A longer message fails at least as often, and collisions come on top
where UAVs contend for the band.
"""

import math
from functools import cached_property
from typing import Any

import msgspec
import numpy as np

from meanflock.channel.base import Channel, failed
from meanflock.swarm import plugins, state
from meanflock.swarm.errors import FAILURES, BadInput
from meanflock.swarm.mission import starts
from meanflock.swarm.scenario import Scenario

STATE_BITS = 64  # of an event
_LOW_DB, _HIGH_DB, _STEP_DB = -300.0, 300.0, 5.0  # bounds of the key
_BISECTIONS = 60
_TOLERANCE = 1e-3  # relative


class Outages:
    """Outages that the radio of a scenario can give."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        places = state.position(starts(scenario))
        first, second = np.triu_indices(len(places), 1)
        near = np.linalg.norm(places[first] - places[second], axis=-1) <= scenario.radio.range_m
        self._links = first[near], second[near]

    def at(self, snr_db: float) -> float | None:
        """The outage at an SNR threshold; None if the channel has no closed form or there are no links.

        Raises:
            RunFailed: the closed form fails.
        """
        radio = msgspec.structs.replace(self._scenario.radio, target_snr_db=snr_db)
        scenario = msgspec.structs.replace(self._scenario, radio=radio)
        channel: Channel = plugins.create("channel", radio.model, radio.options, scenario)
        try:
            links = len(self._links[0])
            expected = channel.at_start(scenario, *self._links, STATE_BITS, "state") if links else None
        except FAILURES as error:
            raise failed(radio.model, error) from error
        return None if expected is None else expected[0] / links

    def snr_db(self, outage: float) -> float:
        """The highest SNR threshold with this outage.

        Raises:
            BadInput: the channel cannot give it.
        """
        name = self._scenario.radio.model
        if not self._by_threshold:
            raise BadInput(
                f"--outages {100 * outage:g}: channel {name!r} has no closed form of its outages, so none can be set; "
                "give missions with another `radio.model`, for example rice"
            )
        below = [snr for snr, value in self._by_threshold.items() if value <= outage]
        low = max(below, default=math.nan)
        high = low + _STEP_DB
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self._value(middle) <= outage else (low, middle)
        if not below or abs(self._value(low) - outage) > _TOLERANCE * outage:
            raise BadInput(f"--outages {100 * outage:g}: channel {name!r} gives {self._range()}")
        return round(low, 6)

    def _value(self, snr_db: float) -> float:
        value = self.at(min(snr_db, _HIGH_DB))
        return math.inf if value is None else value

    @cached_property
    def _by_threshold(self) -> dict[float, float]:
        """Outages on a grid of thresholds; empty without a closed form."""
        grid = np.arange(_LOW_DB, _HIGH_DB + _STEP_DB, _STEP_DB).tolist()
        found: dict[float, Any] = {snr: self.at(snr) for snr in grid}
        return {} if None in found.values() else found

    def _range(self) -> str:
        least, most = min(self._by_threshold.values()), max(self._by_threshold.values())
        if least == most:
            return f"{100 * least:g} %, whatever `radio.target_snr_db` is"
        return f"{100 * least:.3g} to {100 * most:.3g} %, by `radio.target_snr_db`"
