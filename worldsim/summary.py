"""The summary of a run: what was flown, what it cost and how well it went. Unknown is None, never 0."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock import kernels
from meanflock.channel.meter import TRAFFIC, Meter, Traffic
from meanflock.federation.post import Post
from meanflock.swarm import __version__
from meanflock.swarm.faults import Kill
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import Status
from meanflock.worldsim.commands import Commands
from meanflock.worldsim.counters import Counters
from meanflock.worldsim.flight import Flight
from meanflock.worldsim.schedule import Schedule

SCHEMA = 1
MAX_LINKS_LISTED = 1000


def weight_spread(models: NDArray[np.float64]) -> float:
    """Root-mean-square distance of N models `(N, 246)` from their mean."""
    deviation = models - np.add.reduce(models, axis=-2, keepdims=True) / models.shape[-2]
    deviation *= deviation
    squared = np.add.reduce(deviation, axis=-1)
    return float(np.sqrt(np.add.reduce(squared, axis=-1) / models.shape[-2]))


def flight_summary(flight: Flight) -> dict[str, Any]:
    """What the flight itself says; energies until own arrival, and until the end under `energy_end_…`."""
    scenario = flight.scenario
    arrived = flight.arrival_tick >= 0
    times = (flight.arrival_tick - flight.launch_tick)[arrived] * scenario.dt
    energy = np.where(arrived, flight.arrival_energy, flight.energy)
    return {
        "ticks": flight.tick,
        "sim_time_s": flight.time_s,
        "arrived": int(arrived.sum()),
        "lost": int((flight.status == Status.LOST).sum()),
        "t_avg_s": float(times.mean()) if arrived.any() else None,
        "t_max_s": float(times.max()) if arrived.any() else None,
        "energy_mean_J": float(energy.mean()),
        "energy_std_J": float(energy.std()),
        "energy_end_mean_J": float(flight.energy.mean()),
        "energy_end_std_J": float(flight.energy.std()),
        "phi_A": flight.phi_a,
        "phi_C": flight.phi_c,
        "phi_C_distinct": flight.phi_c_distinct,
        "collisions": flight.collisions,
        "collisions_all": len(flight.encounters.touched),
        "closest_approach_m": flight.encounters.closest_approach_m,
        "obstacle_hits": int(np.count_nonzero(flight.encounters.hit)),
        "speed_max_m_s": flight.speed_max,
        "speed_mean_m_s": flight.mean_speed,
        "distance_mean_m": float(flight.distance.mean()),
        "control_effort": float(flight.effort.mean() * scenario.dt),
        "trajectory_sha256": flight.trajectory_sha256,
    }


def radio_summary(meter: Meter, *, all_arrived: bool) -> dict[str, Any]:
    """What the radio cost, observed beside the closed forms; until the last arrival, where all arrived."""
    to_arrival = meter.marked if all_arrived and meter.marked is not None else meter.bits()
    links, total = meter.links(), meter.all_kinds()
    return {
        "payload_bits": {
            **{name: meter.traffic[kind].payload_bits for kind, name in TRAFFIC.items()},
            "total": total.payload_bits,
        },
        "bits_to_arrival": {**dict(zip(TRAFFIC.values(), to_arrival, strict=True)), "total": sum(to_arrival)},
        "wire_bytes": total.wire_bytes,
        "radio": {
            **_observed(total),
            "airtime_s": total.airtime_s,
            "traffic": {name: _kind(meter.traffic[kind]) for kind, name in TRAFFIC.items()},
            "links_used": len(links),
            "links": links if len(links) <= MAX_LINKS_LISTED else None,  # [source, target, sent, outages]
        },
    }


def _kind(bill: Traffic) -> dict[str, Any]:
    return {
        "transmissions": bill.transmissions,
        "payload_bits": bill.payload_bits,
        "wire_bytes": bill.wire_bytes,
        "airtime_s": bill.airtime_s,
        **_observed(bill),
    }


def _observed(bill: Traffic) -> dict[str, Any]:
    """Latency is of delivered messages: what a lost one would have taken nobody has seen."""
    rate = latency = None
    if bill.sent and bill.expected_outages is not None and bill.expected_delivered_slots is not None:
        rate, expected_delivered = bill.expected_outages / bill.sent, bill.sent - bill.expected_outages
        latency = bill.expected_delivered_slots / expected_delivered if expected_delivered > 0 else None
    return {
        "sent": bill.sent,
        "delivered": bill.delivered,
        "outages": bill.outages,
        "outage_rate": bill.outages / bill.sent if bill.sent else None,
        "outage_rate_theory": rate,
        "latency_slots_mean": bill.delivered_slots / bill.delivered if bill.delivered else None,
        "latency_slots_mean_theory": latency,
    }


def protocol_summary(
    counters: Counters,
    post: Post,
    commands: Commands,
    names: Sequence[str],
    schedule: Schedule | None,
    blocks_dropped: int,
) -> dict[str, Any]:
    """What only the node knows. `names`: of the diagnostics. `schedule`: of a flight in real time."""
    largest = dict(zip(names, commands.largest.tolist(), strict=True))
    return {
        "rounds": post.rounds,
        "rounds_void": post.rounds_void,
        "diagnostics": dict(zip(names, commands.summed.tolist(), strict=True)),
        "diagnostics_max": largest,
        "hjb_residual_max": largest.get("hjb_residual"),
        "fpk_residual_max": largest.get("fpk_residual"),
        "weight_spread_final": counters.spread,
        "nodes_lost": counters.nodes_lost,
        "nodes_rejoined": counters.nodes_rejoined,
        "uploads_refused": counters.uploads_refused,
        "states_refused": counters.states_refused,
        "dropped_messages": dict(counters.dropped),
        "held_commands": None if schedule is None else counters.held,
        "realtime": None
        if schedule is None
        else {
            "factor": schedule.factor,
            "deadline_misses": counters.deadline_misses,
            "tick_start_jitter_ms": schedule.jitter_ms(),
        },
        "telemetry_blocks_dropped": blocks_dropped,
    }


def summary(flight: Flight, meter: Meter, run_id: str, mode: str, wall_time_s: float) -> dict[str, Any]:
    """What was flown, and how well it went, all but what `protocol_summary` says."""
    scenario = flight.scenario
    return {
        "schema": SCHEMA,
        "run_id": run_id,
        "version": __version__,
        "scenario_sha256": scenario.sha256(),
        "method": str(scenario.method),
        "uavs": scenario.uavs,
        "seed": scenario.seed,
        "mode": mode,
        "backend": kernels.BACKEND,
        "wall_time_s": wall_time_s,
        "real_time_factor": flight.time_s / wall_time_s if wall_time_s > 0 else None,
        **flight_summary(flight),
        **radio_summary(meter, all_arrived=bool((flight.arrival_tick >= 0).all())),
    }


def every_uav_was_lost(scenario: Scenario, record: Mapping[str, Any]) -> bool:
    """Whether a flight lost all its UAVs, some of them by other means than the fault script. Such a run has failed."""
    kills = [fault for fault in scenario.faults if isinstance(fault, Kill)]
    killed = {uav for kill in kills if kill.begins(scenario.dt) < record["ticks"] for uav in kill.uavs}
    return bool(record["lost"] == scenario.uavs > len(killed))
