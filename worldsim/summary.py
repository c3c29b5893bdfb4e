"""Summary of a run: what was flown, what it cost and how well it went.

An unknown quantity is None, never 0.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from meanflock import kernels
from meanflock.channel.meter import TRAFFIC, Meter, Traffic
from meanflock.channel.nodes import nodes_of
from meanflock.federation.plan import plugins_of
from meanflock.swarm import __version__, mission
from meanflock.swarm.faults import Kill
from meanflock.swarm.provenance import provenance
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats
from meanflock.swarm.wire.messages import FrameKind, Status
from meanflock.worldsim.clocks import TickSchedule
from meanflock.worldsim.encounters import Pair
from meanflock.worldsim.flight import Flight
from meanflock.worldsim.world import World

SCHEMA = 1
MAX_LINKS_LISTED = 1000


def flight_summary(flight: Flight) -> dict[str, Any]:
    """Fields from the flight. Energies count until a UAV's own arrival; `energy_end_…` until the end of the flight."""
    return {
        "ticks": flight.tick,
        "sim_time_s": flight.time_s,
        **_travelled(flight, slice(None)),
        "energy_end_mean_J": float(flight.energy.mean()),
        "energy_end_std_J": float(flight.energy.std()),
        "phi_A": flight.phi_a,
        "phi_A_standard_error": flight.phi_a_standard_error,
        "phi_C": flight.phi_c,
        "phi_C_distinct": flight.phi_c_distinct,
        "collisions": flight.collisions,
        "collisions_all": len(flight.encounters.touched),
        "collisions_at_ticks": len(flight.encounters.collided_at_ticks),
        "closest_approach_m": flight.encounters.closest_approach_m,
        "obstacle_hits": int(np.count_nonzero(flight.encounters.hit)),
        "grounded": int(np.count_nonzero(flight.ground.touched)) if flight.ground.is_there else None,
        "altitude_violations": int(np.count_nonzero(flight.altitude.beyond)) if flight.altitude.limits else None,
        "speed_max_m_s": flight.speed_max,
        "speed_mean_m_s": flight.mean_speed,
        "clipped_uav_ticks": flight.clipped,
        "trajectory_sha256": flight.trajectory_sha256,
    }


def _travelled(flight: Flight, rows: slice) -> dict[str, Any]:
    """How the UAVs in some rows travelled."""
    arrived, status = flight.arrival_tick[rows] >= 0, flight.status[rows]
    times = (flight.arrival_tick - flight.launch_tick)[rows][arrived] * flight.scenario.dt
    energy = np.where(arrived, flight.arrival_energy[rows], flight.energy[rows])
    return {
        "arrived": int(arrived.sum()),
        "lost": int((status == Status.LOST).sum()),
        "landed": int((status == Status.LANDED).sum()),
        "t_avg_s": float(times.mean()) if arrived.any() else None,
        "t_max_s": float(times.max()) if arrived.any() else None,
        "energy_mean_J": float(energy.mean()),
        "energy_std_J": float(energy.std()),
        "distance_mean_m": float(flight.distance[rows].mean()),
        "control_effort": float(flight.effort[rows].mean() * flight.scenario.dt),
    }


def group_summary(world: World) -> dict[str, Any] | None:
    """Fields of each group, by its name; None without groups. A collision of two groups counts in both."""
    flight, meter, measured, bills = world.flight, world.air.meter, world.flight.by_group, world.air.meter.groups
    if measured is None or bills is None:
        return None
    has, names = world.plan.has_diagnostic, world.plan.declared.diagnostics
    world.commands.settle()
    found: dict[str, Any] = {}
    for number, (group, rows) in enumerate(mission.parts(world.scenario)):
        own = np.ones(len(names), dtype=bool) if has is None else has[rows.start]
        summed = zip(names, world.commands.of_groups[number].tolist(), own, strict=True)
        all_arrived = bool((flight.arrival_tick[rows] >= 0).all())
        found[group.name] = {
            "method": world.scenario.of_group(group).method,
            "uavs": group.count,
            **_travelled(flight, rows),
            "phi_A": measured.phi_a(number),
            "collisions": _with_any_of(rows, flight.encounters.collided),
            "collisions_all": _with_any_of(rows, flight.encounters.touched),
            "closest_approach_m": measured.closest_approaches_m[number],
            "obstacle_hits": int(np.count_nonzero(flight.encounters.hit[rows])),
            "airtime_s": float(meter.loads[0][rows].sum() * meter.radio.coherence_time_s),
            "payload_bits": _named(bills.until(number, arrival=False)),
            "bits_to_arrival": _named(bills.until(number, arrival=all_arrived)),
            "diagnostics": {name: total for name, total, is_own in summed if is_own},
        }
    return found


def _with_any_of(rows: slice, pairs: set[Pair]) -> int:
    """Number of pairs that have a UAV of some rows."""
    uavs = range(rows.start, rows.stop)
    return sum(first in uavs or second in uavs for first, second in pairs)


def _named(bits: Mapping[FrameKind, int]) -> dict[str, int]:
    """Bits by the name of their kind, with their total."""
    return {name: bits[kind] for kind, name in TRAFFIC.items()} | {"total": sum(bits.values())}


def radio_summary(world: World, *, all_arrived: bool) -> dict[str, Any]:
    """Fields from the radio: bits, and observed outages and latency beside their closed forms.

    `bits_to_arrival` counts until the last arrival if all UAVs arrived, else until the end.
    """
    air, meter = world.air, world.air.meter
    to_arrival = meter.marked if all_arrived and meter.marked is not None else meter.bits()
    links = meter.links()
    total = meter.all_kinds()
    return {
        "payload_bits": _named({kind: meter.traffic[kind].payload_bits for kind in TRAFFIC}),
        "bits_to_arrival": _named(dict(zip(TRAFFIC, to_arrival, strict=True))),
        "wire_bytes": total.wire_bytes,
        "radio": {
            **_observed(total),
            "airtime_s": total.airtime_s,
            "clamped": air.clamped,
            "handovers": air.serving.handovers,
            "backhaul_bits": world.backhaul.bits,
            "duty_max": float(world.consumption.duty.max()),
            "nodes": _nodes(world),
            "band_time_Hz_s": band_time_Hz_s(meter, nodes_of(world.scenario).bandwidth_hz),
            "traffic": {name: _kind(meter.traffic[kind]) for kind, name in TRAFFIC.items()},
            "links_used": len(links),
            "links": links if len(links) <= MAX_LINKS_LISTED else None,  # [source, target, sent, outages]
        },
    }


def _nodes(world: World) -> list[list[float]] | None:
    """Rows [node, airtime_s, received_s, energy_J] of all nodes, stations last; None if there are many."""
    meter, energy_J = world.air.meter, world.consumption.radio_J
    if len(energy_J) > MAX_LINKS_LISTED:
        return None
    lasts, _, heard = meter.loads * meter.radio.coherence_time_s
    return [[node, *row] for node, row in enumerate(np.stack([lasts, heard, energy_J], axis=-1).tolist())]


def band_time_Hz_s(meter: Meter, bandwidth_hz: Floats) -> float:
    """Spectrum that traffic takes, band × time: of all links where each has its band; in one band, of the airtime.

    `bandwidth_hz`: (N + B,), of what each node sends.
    """
    lasts, slots, _ = meter.radio.coherence_time_s * meter.loads
    return float((slots if meter.radio.access == "fdma" else lasts) @ bandwidth_hz)


def _kind(bill: Traffic) -> dict[str, Any]:
    return {
        "transmissions": bill.transmissions,
        "payload_bits": bill.payload_bits,
        "wire_bytes": bill.wire_bytes,
        "airtime_s": bill.airtime_s,
        **_observed(bill),
    }


def _observed(bill: Traffic) -> dict[str, Any]:
    """Outages and latency. Latency covers delivered messages only: that of a lost one is unknown."""
    rate = latency = None
    if bill.sent and bill.expected_outages is not None and bill.expected_delivered_slots is not None:
        rate = bill.expected_outages / bill.sent
        expected_delivered = bill.sent - bill.expected_outages
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


def protocol_summary(world: World, schedule: TickSchedule | None, *, can_be_steered: bool = False) -> dict[str, Any]:
    """Fields from the protocol.

    `schedule`: of a flight in real time. `can_be_steered`: whether clients could steer UAVs.
    """
    counters, ledger, commands = world.counters, world.ledger, world.commands
    names = world.plan.declared.diagnostics
    commands.settle()
    largest = dict(zip(names, commands.largest.tolist(), strict=True))
    summed = dict(zip(names, commands.summed.tolist(), strict=True))
    world.flight.books.settle()
    ticks = dict(zip(names, commands.ticks(world.flight.books.ticks_on_way), strict=True))
    return {
        "rounds": ledger.rounds,
        "rounds_void": ledger.rounds_void,
        "rounds_isolated": ledger.isolated,
        "uploads_silent": ledger.silent,
        "uploads_late": ledger.late,
        "diagnostics": summed,
        "diagnostics_mean": {name: total / ticks[name] if ticks[name] else None for name, total in summed.items()},
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
        "steered": {"uav_ticks": counters.steered, "replayable": not counters.steered}
        if can_be_steered or counters.steered
        else None,
    }


def summary(
    world: World,
    run: str,
    mode: str,
    wall_time_s: float,
    *,
    schedule: TickSchedule | None = None,
    can_be_steered: bool = False,
    blocks_dropped: int = 0,
) -> dict[str, Any]:
    """The summary of a run.

    Args:
        run: its name. mode: how its nodes ran. schedule: of a flight in real time. can_be_steered: whether clients
            could steer UAVs. blocks_dropped: blocks of telemetry that were given up.
    """
    flight, scenario = world.flight, world.scenario
    return {
        "schema": SCHEMA,
        "run_id": run,
        "version": __version__,
        "provenance": provenance(plugins_of(scenario)),
        "scenario_sha256": scenario.sha256(),
        "method": world.plan.method,
        "uavs": scenario.uavs,
        "seed": scenario.seed,
        "mode": mode,
        "backend": kernels.BACKEND,
        "wall_time_s": wall_time_s,
        "world_time_s": world.counters.world_s,
        "real_time_factor": flight.time_s / wall_time_s if wall_time_s > 0 else None,
        **flight_summary(flight),
        **radio_summary(world, all_arrived=bool((flight.arrival_tick >= 0).all())),
        **world.consumption.totals(),
        **protocol_summary(world, schedule, can_be_steered=can_be_steered),
        "until": world.target.summary(),
        "waypoints_reached": world.flight.guide.reached if scenario.has_waypoints else None,
        "turned_back": int(world.flight.guide.homeward.sum()) if scenario.energy.battery_J is not None else None,
        "batteries_empty": world.batteries_empty if scenario.energy.battery_J is not None else None,
        "groups": group_summary(world),
        "telemetry_blocks_dropped": blocks_dropped,
        "models_sha256": world.models.hexdigest,
    }


def every_uav_was_lost(scenario: Scenario, record: Mapping[str, Any]) -> bool:
    """Returns whether a run failed because it lost all its UAVs, at least one of them not by the fault script."""
    kills = [fault for fault in scenario.faults if isinstance(fault, Kill)]
    killed = {uav for kill in kills if kill.begins(scenario.dt) < record["ticks"] for uav in kill.uavs}
    return bool(record["lost"] == scenario.uavs > len(killed))
