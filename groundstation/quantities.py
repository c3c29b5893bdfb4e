"""What every quantity is called, in tables, plots, recordings and documentation alike: one name each, with its unit."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from meanflock.swarm.errors import BadInput


@dataclass(frozen=True, slots=True)
class Quantity:
    """A name as people read it. remark: what has to be known to read the number; it follows the unit."""

    name: str
    unit: str = ""
    remark: str = ""

    @property
    def remarked(self) -> str:
        """The name for a title: `alignment φ_A, lower is better`."""
        return f"{self.name}, {self.remark}" if self.remark else self.name

    @property
    def qualified_unit(self) -> str:
        """The unit for a column of its own: `m/s, lower is better`."""
        return ", ".join(part for part in (self.unit, self.remark) if part)

    def title(self, of: str = "") -> str:
        """The name with its unit: `speed, m/s: mean, min, max`."""
        named = ", ".join(part for part in (self.name, self.unit, self.remark) if part)
        return f"{named}: {of}" if of else named


TRAVEL_TIME = Quantity("travel time", "s")
ENERGY_TO_ARRIVAL = Quantity("energy until own arrival", "J")
ENERGY = Quantity("energy, past arrival too", "J")
ALIGNMENT = Quantity("alignment φ_A", "m/s", "lower is better")
RISK_PRINTED = Quantity("collision risk φ_C with self-pairs")
RISK = Quantity("collision risk φ_C, distinct pairs")
COLLISIONS = Quantity("collisions", "pairs")
SPEED = Quantity("speed", "m/s")
DISTANCE = Quantity("distance flown", "m")
PAYLOAD = Quantity("payload", "bits")
OUTAGES = Quantity("outages", "messages")
ARRIVED = Quantity("arrived", "UAVs")
INTERACTION = Quantity("interaction term φ_G", "1/s²")
HJB_RESIDUAL = Quantity("HJB residual |e_H|", "m/s")
FPK_RESIDUAL = Quantity("FPK residual |e_F|", "1/s")
SPREAD = Quantity("spread of the models")

FIELDS: dict[str, Quantity] = {  # of summaries, time series and the tables of the paper's study
    "t_avg_s": TRAVEL_TIME,
    "t_max_s": TRAVEL_TIME,
    "t_avg_censored_s": TRAVEL_TIME,
    "energy_mean_J": ENERGY_TO_ARRIVAL,
    "energy_std_J": ENERGY_TO_ARRIVAL,
    "energy_trip_mean_J": ENERGY_TO_ARRIVAL,
    "energy_end_mean_J": ENERGY,
    "energy_end_std_J": ENERGY,
    "energy_J": ENERGY,
    "phi_A": ALIGNMENT,
    "phi_A_tavg": ALIGNMENT,
    "phi_C": RISK_PRINTED,
    "phi_C_tavg": RISK_PRINTED,
    "phi_C_distinct": RISK,
    "collisions": COLLISIONS,
    "speed_max_m_s": SPEED,
    "speed_mean_m_s": SPEED,
    "distance_mean_m": DISTANCE,
    "payload_bits.total": PAYLOAD,
    "outages": OUTAGES,
    "arrived": ARRIVED,
    "phi_G": INTERACTION,
    "hjb_residual": HJB_RESIDUAL,
    "hjb_residual_max": HJB_RESIDUAL,
    "fpk_residual": FPK_RESIDUAL,
    "fpk_residual_max": FPK_RESIDUAL,
    "weight_spread": SPREAD,
    "weight_spread_final": SPREAD,
}
RESIDUALS = ("hjb_residual", "fpk_residual")  # sizes that span several decades: drawn as logarithms


def of(field: str) -> Quantity:
    """The quantity of a field; one that is not known here is called by its own name."""
    return FIELDS.get(field) or Quantity(field)


def number(summary: Mapping[str, Any], key: str) -> float:
    """A number of a summary by its dotted key; NaN where it is unknown.

    Raises:
        BadInput: a summary has no such number.
    """
    value: Any = summary
    for part in key.split("."):
        if not isinstance(value, Mapping) or part not in value:
            raise BadInput(f"{key}: a summary has no such entry")
        value = value[part]
    if value is None:
        return math.nan
    if isinstance(value, str | Mapping | Sequence):
        raise BadInput(f"{key}: not a number")
    return float(value)
