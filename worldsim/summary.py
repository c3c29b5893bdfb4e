"""Counters, wall-clock time and summary of a run: what was flown, what it cost and how well it went.

An unknown quantity is None, never 0.
"""

import math
from array import array
from bisect import bisect_left
from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import accumulate
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock import kernels
from meanflock.channel.meter import TRAFFIC, Meter, Traffic
from meanflock.federation.post import Post
from meanflock.swarm import __version__
from meanflock.swarm.errors import BadInput
from meanflock.swarm.faults import Kill
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import Status
from meanflock.worldsim.barrier import Commands
from meanflock.worldsim.flight import Flight

BOUNDS_S = (0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0)


def factor(text: str) -> float:
    """Parse the option --realtime: how many times faster than the wall clock the flight goes.

    Raises:
        BadInput: not a number above 0.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 < value < math.inf:
        raise BadInput(
            f"--realtime {text}: how many times faster than the wall clock, above 0; for example --realtime=2"
        )
    return value


class Schedule:
    """Begin and end of each tick of a flight that follows the wall clock, on the monotonic clock."""

    def __init__(self, factor: float, dt: float) -> None:
        """`factor`: simulated seconds a second. `dt`: simulated seconds a tick."""
        self.factor = factor
        self._tick_s = dt / factor
        self._late_s = array("f")  # one number a tick: a day in real time is 3.5 MB

    def begin(self, now: float) -> None:
        """Begin the next tick. The first tick defines the schedule, so it is in time."""
        if not self._late_s:
            self._start = now
        self._late_s.append(now - self._start - len(self._late_s) * self._tick_s)

    @property
    def end(self) -> float:
        """Time at which the current tick ends and the next one should begin."""
        return self._start + len(self._late_s) * self._tick_s

    def jitter_ms(self) -> dict[str, float | None]:
        """Delay of the begin of a tick behind its schedule: mean, 99th percentile and maximum."""
        if not self._late_s:
            return {"mean": None, "p99": None, "max": None}
        late = np.frombuffer(self._late_s, dtype=np.float32) * 1e3
        return {
            "mean": float(late.mean(dtype=np.float64)),
            "p99": float(np.percentile(late, 99)),
            "max": float(late.max()),
        }


class Durations:
    """Histogram of durations. `add` is cheap enough for every tick; other threads may read at any time."""

    def __init__(self) -> None:
        self._counts = [0] * (len(BOUNDS_S) + 1)  # the last one: beyond all bounds
        self.total_s = 0.0

    def add(self, seconds: float) -> None:
        """Count one duration."""
        self._counts[bisect_left(BOUNDS_S, seconds)] += 1
        self.total_s += seconds

    @property
    def cumulative(self) -> list[tuple[str, int]]:
        """Pairs of an upper bound in seconds and the number of durations up to it; the last bound is +Inf."""
        bounds = [*(f"{bound:g}" for bound in BOUNDS_S), "+Inf"]
        return list(zip(bounds, accumulate(list(self._counts)), strict=True))


SCHEMA = 1
_AT_ONCE = 2**15  # weights whose deviations stay in a processor's cache
MAX_LINKS_LISTED = 1000


class Counters:
    """Counters of the protocol, from take-off on, resumes included. Flight and radio have counters of their own.

    Attributes:
        held: commands held over because they were late, in real time.
        deadline_misses: ticks with at least one such command.
        steered: commands replaced by those of clients; one for each UAV and tick.
        nodes_lost: nodes lost in flight.
        nodes_rejoined: nodes that joined in flight, in the place of a lost one or as a standby.
        uploads_refused: models that a node did not average.
        states_refused: implausible states that nodes received, one for each tick and sending UAV.
        implausible: the UAVs that sent them.
        wall_s: wall-clock time flown before the run was resumed.
        spread: distance of the models from their mean when last measured; None if never.
        drops: messages that the world rejected, by reason.
    """

    def __init__(self, refused: Counter[str] | None = None) -> None:
        """`refused`: messages that the bus keeps from the world, by reason."""
        self._refused = refused if refused is not None else Counter()
        self.held = 0
        self.deadline_misses = 0
        self.steered = 0
        self.nodes_lost = 0
        self.nodes_rejoined = 0
        self.uploads_refused = 0
        self.states_refused = 0
        self.implausible: set[int] = set()
        self.wall_s = 0.0
        self.spread: float | None = None
        self.drops: Counter[str] = Counter()

    def late(self, commands: int) -> None:
        """Count the late commands of a tick in real time."""
        self.held += commands
        self.deadline_misses += commands > 0

    @property
    def dropped(self) -> Counter[str]:
        """Messages rejected by the world or the bus, by reason. Safe to read from any thread."""
        return self.drops.copy() + self._refused.copy()

    def snapshot(self, wall_s: float) -> dict[str, Any]:
        """The counters, for `restore`."""
        return {
            **self._numbers(),
            "wall_s": wall_s,
            "spread": self.spread,
            "drops": dict(self.drops),
            "implausible": sorted(self.implausible),
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Continue with the counts of a snapshot."""
        for name, number in self._numbers().items():
            setattr(self, name, type(number)(snapshot.get(name, 0)))
        self.spread = snapshot["spread"]
        self.drops = Counter(snapshot["drops"])
        self.implausible = set(snapshot["implausible"])

    def _numbers(self) -> dict[str, int | float]:
        return {name: value for name, value in vars(self).items() if isinstance(value, int | float)}


def weight_spread(models: NDArray[np.float64]) -> float:
    """Root-mean-square distance of N models (N, W) from their mean."""
    count, weights = models.shape
    mean, squared = np.add.reduce(models, axis=0) / count, np.empty(count)
    rows = max(1, _AT_ONCE // weights)
    for first in range(0, count, rows):
        here = slice(first, first + rows)
        deviation = models[here] - mean
        deviation *= deviation
        np.add.reduce(deviation, axis=1, out=squared[here])
    return float(np.sqrt(np.add.reduce(squared) / count))


def flight_summary(flight: Flight) -> dict[str, Any]:
    """Fields from the flight. Energies count until a UAV's own arrival; `energy_end_…` until the end of the flight."""
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
        "clipped_uav_ticks": flight.clipped,
        "trajectory_sha256": flight.trajectory_sha256,
    }


def radio_summary(meter: Meter, *, all_arrived: bool) -> dict[str, Any]:
    """Fields from the radio: bits, and observed outages and latency beside their closed forms.

    `bits_to_arrival` counts until the last arrival if all UAVs arrived, else until the end.
    """
    to_arrival = meter.marked if all_arrived and meter.marked is not None else meter.bits()
    links = meter.links()
    total = meter.all_kinds()
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


def energy_summary(flight: Flight, airtime_s: float) -> dict[str, Any]:
    """Fields of the energy of all UAVs until the end of the flight, radio and computer included."""
    constants = flight.scenario.energy
    radio = constants.radio_W * airtime_s
    compute = constants.step_J * flight.steps
    return {
        "energy_radio_J": radio,
        "energy_compute_J": compute,
        "energy_total_J": float(flight.energy.sum()) + radio + compute,
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


def protocol_summary(
    counters: Counters,
    post: Post,
    commands: Commands,
    names: Sequence[str],
    schedule: Schedule | None,
    blocks_dropped: int,
    *,
    can_be_steered: bool = False,
) -> dict[str, Any]:
    """Fields from the protocol. `names`: of the diagnostics. `schedule`: of a flight in real time.
    `can_be_steered`: whether clients could.
    """
    largest = dict(zip(names, commands.largest.tolist(), strict=True))
    return {
        "rounds": post.rounds,
        "rounds_void": post.rounds_void,
        "rounds_isolated": post.isolated,
        "uploads_silent": post.silent,
        "uploads_late": post.late,
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
        "steered": {"uav_ticks": counters.steered, "replayable": not counters.steered}
        if can_be_steered or counters.steered
        else None,
        "telemetry_blocks_dropped": blocks_dropped,
    }


def summary(flight: Flight, meter: Meter, run_id: str, mode: str, wall_time_s: float) -> dict[str, Any]:
    """All fields but those of `protocol_summary`."""
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
        **energy_summary(flight, meter.total("airtime_s")),
    }


def every_uav_was_lost(scenario: Scenario, record: Mapping[str, Any]) -> bool:
    """Returns whether a run failed because it lost all its UAVs, at least one of them not by the fault script."""
    kills = [fault for fault in scenario.faults if isinstance(fault, Kill)]
    killed = {uav for kill in kills if kill.begins(scenario.dt) < record["ticks"] for uav in kill.uavs}
    return bool(record["lost"] == scenario.uavs > len(killed))
