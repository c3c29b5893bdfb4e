"""Target of a flight: a metric that a round reaches, at which the flight ends, and what it cost to get there."""

from typing import Any

from meanflock.swarm.events import RoundEnded
from meanflock.swarm.scenario import Scenario, Until
from meanflock.swarm.stateful import Stateful


class MetricTarget(Stateful):
    """The key `until` of a scenario. Without the key nothing is ever reached.

    Attributes:
        reached: round, time, bits, airtime and energy when it was; empty before.
    """

    stored = ("stored_reached",)

    def __init__(self, scenario: Scenario) -> None:
        self._dt = scenario.dt
        self._until = None if scenario.until is None else Until.of_text(scenario.until)
        self.reached: dict[str, Any] = {}

    def is_met(self, ended: RoundEnded) -> bool:
        """Returns whether a round that ended is the first to reach the target."""
        if self._until is None or self.reached:
            return False
        value = ended.metrics.get(self._until.metric, ended.diagnostics.get(self._until.metric))
        return value is not None and self._until.is_met(value)

    def reach(self, ended: RoundEnded, energy_J: float) -> None:
        """Note the round that reached the target, and the energy spent so far."""
        self.reached = {
            "round": ended.number,
            "time_s": round(ended.tick * self._dt, 6),
            "bits": ended.bits,
            "airtime_s": ended.airtime_s,
            "energy_J": energy_J,
        }

    @property
    def stored_reached(self) -> dict[str, Any]:
        """What a checkpoint stores."""
        return self.reached

    @stored_reached.setter
    def stored_reached(self, stored: dict[str, Any]) -> None:
        self.reached = dict(stored)

    def summary(self) -> dict[str, Any] | None:
        """The target and what it cost; None without one."""
        if self._until is None:
            return None
        nothing = dict.fromkeys(("round", "time_s", "bits", "airtime_s", "energy_J"))
        target = {"metric": self._until.metric, "value": self._until.value, "reached": bool(self.reached)}
        return target | (self.reached or nothing)
