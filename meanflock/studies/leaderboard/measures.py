"""Measures of a leaderboard: one number for each flight, with unit and direction."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from meanflock.results import quantities


@dataclass(frozen=True)
class Measure:
    """A column of the tables.

    key: in leaderboard.json, with its unit. heading: of the column; short: in a terminal of 80 columns, empty if it has
    no room there. about: a sentence. field: of the summary, if it is one. better: which end is. share: a yes or no,
    with the exact binomial interval of its mean. least: the least of all flights is shown too. optional: left out of
    tables in which no row has it. of_safe: only safe rows are compared, see `marks.is_safe`.
    """

    key: str
    heading: str
    unit: str
    about: str
    field: str = ""
    short: str = ""
    better: Literal["less", "more"] = "less"
    share: bool = False
    least: bool = False
    optional: bool = False
    of_safe: bool = False

    @property
    def titled(self) -> str:
        """The heading with its unit."""
        return f"{self.heading}, {self.unit}" if self.unit else self.heading


def _registered(key: str, heading: str, name: str, **rest: Any) -> Measure:
    """A measure that is a field of the summary, with its unit and meaning."""
    field = quantities.field(name)
    return Measure(key, heading, field.unit if field.unit != "1" else "", field.about, name, **rest)


MEASURES = (
    _registered("time_s", "T", "t_avg_censored_s", short="T", of_safe=True),
    Measure("arrived", "arrived", "%", "share of the UAVs that arrived", short="arr.", better="more"),
    _registered("energy_J", "energy", "energy_mean_J", short="energy", of_safe=True),
    Measure(
        "regret_J",
        "regret",
        "J",
        "energy above the least that any flight of one UAV alone needs for its time",
        short="regret",
        of_safe=True,
    ),
    Measure(
        "cost_J", "cost", "J", "energy and the price of the time it took", short="cost", optional=True, of_safe=True
    ),
    Measure("tracking", "tracking cost", "", "tracking cost a UAV, as the controller reports it", optional=True),
    _registered("collisions", "collisions, flying", "collisions"),
    _registered("collisions_all", "collisions, all", "collisions_all", short="coll."),
    _registered("closest_m", "closest", "closest_approach_m", short="near", better="more", least=True),
    _registered("obstacle_hits", "obstacles hit", "obstacle_hits", optional=True),
    Measure(
        "free",
        "free flights",
        "%",
        "share of flights without any collision or hit",
        short="free",
        better="more",
        share=True,
    ),
    _registered("phi_A_m_s", "φ_A", "phi_A"),
    _registered("effort_m2_s3", "effort", "control_effort", of_safe=True),
    Measure("kbit", "radio", "kbit", "payload sent by all UAVs until the last arrival", short="radio"),
    Measure("infeasible", "infeasible", "", "ticks in which a UAV's filter had no answer, all UAVs", optional=True),
)
TOTAL = "total"  # of the total of bits
BY_KEY = {measure.key: measure for measure in MEASURES}


def of_flight(
    result: Mapping[str, Any], regret_J: float | None, price_W: float | None, obstacles: bool
) -> dict[str, float]:
    """Every measure of one flight; NaN if it has no such number.

    Args:
        result: of `flights.fly`, or a group's part of it. regret_J: its regret, if that is known. price_W: of time,
            J/s, if the mission has one. obstacles: whether there are any.
    """
    uavs, reported = result["uavs"], result.get("diagnostics") or {}
    tracking = reported.get("tracking_cost")
    numbers = {measure.key: result[measure.field] for measure in MEASURES if measure.field} | {
        "arrived": result["arrived"] / uavs,
        "regret_J": regret_J,
        "cost_J": None if price_W is None else result["energy_mean_J"] + price_W * result["t_avg_censored_s"],
        "tracking": None if tracking is None else tracking / uavs,
        "free": float(result["collisions_all"] == 0 and not result["obstacle_hits"]),
        "kbit": result["bits_to_arrival"][TOTAL] / 1e3,
        "infeasible": reported.get("infeasible"),
    }
    if not obstacles:
        numbers["obstacle_hits"] = None
    return {measure.key: math.nan if (value := numbers[measure.key]) is None else float(value) for measure in MEASURES}
