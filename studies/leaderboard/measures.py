"""What a leaderboard measures of a flight: one number a flight each, with unit and direction."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from meanflock.groundstation.quantities import FIELDS


@dataclass(frozen=True)
class Measure:
    """A column of the tables.

    key: in leaderboard.json, with its unit. heading: over the column. about: a sentence. better: which end is.
    share: the mean of yes and no, with the exact binomial interval. least: the least of all flights is shown, too.
    optional: left out of tables where no row has it.
    """

    key: str
    heading: str
    unit: str
    about: str
    better: Literal["less", "more"] = "less"
    share: bool = False
    least: bool = False
    optional: bool = False

    @property
    def titled(self) -> str:
        """The heading with its unit."""
        return f"{self.heading}, {self.unit}" if self.unit else self.heading


MEASURES = (
    Measure("time_s", "T", "s", "travel time, mean of the UAVs; one that never arrived counts with the duration"),
    Measure("arrived", "arrived", "%", "share of the UAVs that arrived", better="more"),
    Measure("energy_J", "energy", "J", f"{FIELDS['energy_mean_J'].name}, or the end of the flight; mean of the UAVs"),
    Measure("regret_J", "regret", "J", "energy above the least that any flight of one UAV alone needs for its time"),
    Measure("cost_J", "cost", "J", "energy and the price of the time it took", optional=True),
    Measure("tracking", "tracking cost", "", "what the controller says its tracking cost, a UAV", optional=True),
    Measure("collisions", "collisions, flying", "pairs", "pairs that came too near while both were on the way"),
    Measure("collisions_all", "collisions, all", "pairs", "the same with UAVs that had arrived"),
    Measure("closest_m", "closest", "m", "least distance of any two UAVs in a flight", better="more", least=True),
    Measure("obstacle_hits", "obstacles hit", "", "UAVs that entered an obstacle, each obstacle once", optional=True),
    Measure("free", "free flights", "%", "share of flights without any collision or hit", better="more", share=True),
    Measure("phi_A_m_s", "φ_A", "m/s", f"{FIELDS['phi_A'].remarked}"),
    Measure("effort_m2_s3", "effort", "m²/s³", "∫‖a‖² dt until the arrival of each UAV, mean of the UAVs"),
    Measure("kbit", "radio", "kbit", "payload sent by all UAVs until the last arrival"),
    Measure("infeasible", "infeasible", "", "ticks in which a UAV's filter had no answer, all UAVs", optional=True),
)
TOTAL = "total"  # of bits, beside the kinds
BY_KEY = {measure.key: measure for measure in MEASURES}


def of_flight(
    kept: Mapping[str, Any], regret_J: float | None, price_W: float | None, obstacles: bool
) -> dict[str, float]:
    """Every measure of one flight; NaN where it has no such number.

    Args:
        kept: of `flights.fly`. regret_J: its regret, if that is known. price_W: of time, J/s, where a mission has one.
        obstacles: whether there are any.
    """
    uavs, said = kept["uavs"], kept.get("diagnostics") or {}
    hits, any_pair = kept["obstacle_hits"], kept["collisions_all"]
    tracking, infeasible = said.get("tracking_cost"), said.get("infeasible")
    numbers = {
        "time_s": kept["t_avg_censored_s"],
        "arrived": kept["arrived"] / uavs,
        "energy_J": kept["energy_mean_J"],
        "regret_J": regret_J,
        "cost_J": None if price_W is None else kept["energy_mean_J"] + price_W * kept["t_avg_censored_s"],
        "tracking": None if tracking is None else tracking / uavs,
        "collisions": kept["collisions"],
        "collisions_all": any_pair,
        "closest_m": kept["closest_approach_m"],
        "obstacle_hits": hits if obstacles else None,
        "free": float(any_pair == 0 and not hits),
        "phi_A_m_s": kept["phi_A"],
        "effort_m2_s3": kept["control_effort"],
        "kbit": kept["bits_to_arrival"][TOTAL] / 1e3,
        "infeasible": infeasible,
    }
    return {key: math.nan if value is None else float(value) for key, value in numbers.items()}
