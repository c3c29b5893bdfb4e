"""Which end of a field is better: that of few collisions, and that of many arrivals."""

from fnmatch import fnmatchcase
from functools import cache
from typing import Literal

Better = Literal["less", "more"]

# Keys of the registry; `*` stands for anything. Fields of which neither end is better are left out.
_MORE = ("arrived", "closest_approach_m", "radio.delivered", "rounds", "last_round.*_accuracy")
_LESS = (
    *("lost", "collisions*", "obstacle_hits", "grounded", "altitude_violations", "clipped_uav_ticks"),
    *("t_avg_s", "t_max_s", "t_avg_censored_s", "control_effort", "phi_A", "phi_C*"),
    *("energy_mean_J", "energy_end_mean_J", "energy_radio_J", "energy_compute_J", "energy_total_J"),
    *("payload_bits.*", "bits_to_arrival.*", "wire_bytes", "radio.backhaul_bits", "radio.band_time_Hz_s"),
    *("radio.airtime_s", "radio.duty_max", "radio.outages", "radio.outage_rate", "radio.latency_slots_mean"),
    *("rounds_void", "rounds_isolated", "uploads_late", "uploads_refused", "nodes_lost", "dropped_messages.*"),
    *("hjb_residual_max", "fpk_residual_max", "weight_spread_final"),
    *("until.round", "until.time_s", "until.bits", "until.airtime_s", "until.energy_J"),
    *("last_round.bits", "last_round.airtime_s", "last_round.*_loss", "last_round.*_tracking_cost"),
    *("last_round.*_hjb_residual", "last_round.*_fpk_residual"),
)


@cache
def better(key: str) -> Better | None:
    """The better end of a field; None if neither is, or nobody knows. A field of a group has that of the swarm."""
    if key.startswith("groups."):
        key = key.split(".", 2)[-1]
    if any(fnmatchcase(key, pattern) for pattern in _MORE):
        return "more"
    return "less" if any(fnmatchcase(key, pattern) for pattern in _LESS) else None
