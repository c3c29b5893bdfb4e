"""The registry of quantities: every field that a flight leaves, with its name, unit and meaning.

Tables, plots, recordings, the columns of the time series, docs/data.md, studies and the leaderboard read it. To add a
quantity, add a `Quantity`, and its fields to `SUMMARY`, `COLUMNS` or `DERIVED`.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario, keys_of
from meanflock.swarm.state import PLANE, SPACE
from meanflock.swarm.wire.messages import SWARM_COLUMNS


@dataclass(frozen=True, slots=True)
class Quantity:
    """The name of something that is measured, with its unit.

    remark: what a reader has to know; follows the unit. symbol: on an axis; empty: the name. heading: in a narrow
    column, line by line. logarithmic: sizes that span several decades. share: 0 or 1 of each UAV, whose mean is the
    share of the UAVs.
    """

    name: str
    unit: str = ""
    remark: str = ""
    symbol: str = ""
    heading: str = ""
    logarithmic: bool = False
    share: bool = False

    @property
    def remarked(self) -> str:
        """The name for a title: `alignment φ_A, lower is better`."""
        return f"{self.name}, {self.remark}" if self.remark else self.name

    @property
    def qualified_unit(self) -> str:
        """The unit for a column of its own: `m/s, lower is better`."""
        return ", ".join(part for part in (self.unit, self.remark) if part)

    def title(self, lines: str = "") -> str:
        """The name with its unit, and the lines of a plot: `speed, m/s: mean, min, max`."""
        named = ", ".join(part for part in (self.name, self.unit, self.remark) if part)
        return f"{named}: {lines}" if lines else named


class Field(NamedTuple):
    """A field of summary.json, a column of timeseries.parquet, or a number that a study derives.

    key: dotted; `*` stands for any name. measured: its quantity, or the unit of a field without a name of its own:
    `1` for a pure number, empty for no number. cumulative: counted, summed or averaged since take-off. type: of the
    column; `[]`: an entry a UAV. symbol: on an axis; empty: that of the quantity. optional: whether the summary of an
    older version of meanflock may lack it. varying: whether it tells of the run, or of how it flew, so that the same
    flight may leave another value.
    """

    key: str
    measured: Quantity | str
    about: str
    cumulative: bool = False
    type: str = "float64"
    symbol: str = ""
    optional: bool = False
    varying: bool = False

    @property
    def unit(self) -> str:
        """The unit; `1` for a pure number."""
        return self.measured if isinstance(self.measured, str) else self.measured.unit or "1"


TIME = Quantity("time", "s")
TRAVEL_TIME = Quantity("travel time", "s", heading="travel\ntime")
TRAVEL_TIME_OF_ALL = Quantity(
    "travel time, duration if never arrived", "s", symbol="travel time", heading=TRAVEL_TIME.heading
)
ENERGY_TO_ARRIVAL = Quantity("energy until own arrival", "J", symbol="energy", heading="energy\nuntil\narrival")
ENERGY = Quantity("energy, past arrival too", "J", symbol="energy")
ALIGNMENT = Quantity("alignment φ_A", "m/s", "lower is better", symbol="φ_A", heading="align-\nment\nφ_A")
RISK_PRINTED = Quantity("collision risk φ_C with self-pairs", symbol="φ_C")
RISK = Quantity("collision risk φ_C, distinct pairs", symbol="φ_C, distinct pairs", heading="risk\nφ_C of\npairs")
COLLISIONS = Quantity("collisions", "pairs", heading="colli-\nsions")
SPEED = Quantity("speed", "m/s")
DISTANCE = Quantity("distance flown", "m", symbol="distance")
PAYLOAD = Quantity("payload", "bits", heading="payload")
OUTAGES = Quantity("outages", "messages")
ARRIVED = Quantity("arrived", "UAVs", heading="arrived")
LOST = Quantity("lost", "UAVs", heading="lost")
LANDED = Quantity("landed for good", "UAVs", "arrived or not", heading="landed")
OBSTACLE_HITS = Quantity("obstacle hits", remark="of a UAV, each obstacle once", heading="obstacle\nhits")
GROUNDED = Quantity("grounded", "UAVs", "before they arrived", heading="grounded")
ALTITUDE_VIOLATIONS = Quantity("altitude violations", remark="beyond floor or ceiling", heading="altitude\nviolations")
WAYPOINTS_REACHED = Quantity("waypoints reached", heading="waypoints\nreached")
TURNED_BACK = Quantity("turned back", "UAVs", "low battery", heading="turned\nback")
BATTERIES_EMPTY = Quantity("batteries empty", "UAVs", "in the air", heading="batteries\nempty")
INTERACTION = Quantity("interaction term φ_G", "1/s²", symbol="φ_G", heading="inter-\naction\nφ_G")
HJB_RESIDUAL = Quantity("HJB residual |e_H|", "m/s", symbol="|e_H|", heading="HJB\nresidual\ne_H", logarithmic=True)
FPK_RESIDUAL = Quantity("FPK residual |e_F|", "1/s", symbol="|e_F|", heading="FPK\nresidual\ne_F", logarithmic=True)
ROLL, PITCH, YAW = Quantity("roll", "rad"), Quantity("pitch", "rad"), Quantity("yaw", "rad")
THRUST = Quantity("thrust", "N")
SPREAD = Quantity("spread of the models", symbol="spread")
_SHARE: dict[str, Any] = {"symbol": "share of UAVs", "share": True}
INFEASIBLE = Quantity("no feasible command", heading="no\nfeasible\ncommand", **_SHARE)
UNSENT = Quantity("own state not sent", heading="own\nstate\nnot sent", **_SHARE)
FILTER_INFEASIBLE = Quantity("no feasible command of the filter", heading="filter:\nno feasible\ncommand", **_SHARE)
FILTER_UNSENT = Quantity("own state not sent by the filter", heading="filter:\nown state\nnot sent", **_SHARE)
TRAINING = Quantity("in training", heading="in\ntraining", **_SHARE)
EXAMPLES = Quantity("examples of the last training", symbol="examples", heading="examples\nof the last\ntraining")

PHI_G = "phi_G"  # the diagnostic that colours paths and the map
DIAGNOSTICS = {"hjb_residual": HJB_RESIDUAL, "fpk_residual": FPK_RESIDUAL, PHI_G: INTERACTION}
REPORTED = {  # other diagnostics of installed controllers, filters and learners; files have them by their own names
    "infeasible": INFEASIBLE,
    "unsent": UNSENT,
    "filter_infeasible": FILTER_INFEASIBLE,
    "filter_unsent": FILTER_UNSENT,
    "training": TRAINING,
    "examples": EXAMPLES,
}
ATTITUDE = ("roll_rad", "pitch_rad", "yaw_rad")  # columns of a vehicle, which exports show as an orientation
_ANGLE = "{} of each UAV, rotation about its {} axis; yaw comes first, then pitch, then roll"
SHOWN = {
    "roll_rad": (ROLL, _ANGLE.format("roll", "x")),
    "pitch_rad": (PITCH, _ANGLE.format("pitch", "y")),
    "yaw_rad": (YAW, _ANGLE.format("yaw", "z")),
    "thrust_N": (THRUST, "thrust of each UAV, of all its rotors"),
}

# Fields of the summary that count what most flights have none of.
COUNTS = {
    "lost": LOST,
    "landed": LANDED,
    "obstacle_hits": OBSTACLE_HITS,
    "grounded": GROUNDED,
    "altitude_violations": ALTITUDE_VIOLATIONS,
    "waypoints_reached": WAYPOINTS_REACHED,
    "turned_back": TURNED_BACK,
    "batteries_empty": BATTERIES_EMPTY,
}
# What methods are compared by, in the order of the panels.
COMPARED = (
    "t_avg_censored_s",
    "energy_mean_J",
    "payload_bits.total",
    "phi_A",
    "phi_C_distinct",
    "collisions",
    "arrived",
)

_OF_BOTH = (  # fields of the summary that are columns of the time series, too
    Field("phi_A", ALIGNMENT, "alignment φ_A: mean difference of velocities, lower is better", True),
    Field("phi_C", RISK_PRINTED, "collision risk φ_C as printed, with self-pairs", True),
    Field(
        "phi_C_distinct",
        RISK,
        "collision risk φ_C: share of distinct pairs nearer than r_C at ticks; for a single UAV null, 0 in the series",
        True,
    ),
    Field(
        "collisions",
        COLLISIONS,
        "pairs that came nearer than r_coll in a tick at whose start both were on the way; each pair once",
        True,
    ),
)
_ARRIVED = Field("arrived", ARRIVED, "UAVs that have arrived")

_OF_LINKS = (
    ("sent", "messages", "messages sent over links; a broadcast counts once for each receiver"),
    ("delivered", "messages", "messages delivered"),
    ("outages", OUTAGES, "messages lost in an outage (see the glossary)"),
    ("outage_rate", "1", "outages / sent"),
    ("outage_rate_theory", "1", "closed form of the outage rate at the distances flown"),
    ("latency_slots_mean", "slots", "mean latency of the delivered messages"),
    ("latency_slots_mean_theory", "slots", "closed form of the mean latency at the distances flown"),
)
_KIND = "by kind of traffic: uplink, relay, broadcast or state"

SUMMARY = (
    Field("schema", "1", "version of this record"),
    Field("run_id", "", "name of the run", varying=True),
    Field("version", "", "version of meanflock", varying=True),
    Field(
        "provenance.commit",
        "",
        "commit of the checkout of meanflock that flew, without changes that were not committed; null if there is none",
        optional=True,
        varying=True,
    ),
    Field("provenance.python", "", "version of Python", optional=True, varying=True),
    Field("provenance.numpy", "", "version of NumPy", optional=True, varying=True),
    Field(
        "provenance.plugins.*",
        "",
        "name of the plug-in of each kind, and the version of its package or the hash of its file",
        optional=True,
        varying=True,
    ),
    Field("scenario_sha256", "", "hash of the resolved scenario; equal for equal scenarios"),
    Field("method", "", "name of the controller; of groups, the names of all, joined by `+`"),
    Field("uavs", "UAVs", "number of UAVs"),
    Field("seed", "1", "seed of all randomness"),
    Field("mode", "", "`processes`, or `in-process` if all nodes were in one process", varying=True),
    Field("backend", "", "kernels of the world: `compiled` or `numpy`", varying=True),
    Field("wall_time_s", "s", "wall time of the flight", varying=True),
    Field(
        "world_time_s",
        "s",
        "wall time that the world took; the rest is that of the UAVs, their messages and telemetry",
        optional=True,
        varying=True,
    ),
    Field("real_time_factor", "1", "simulated seconds per second of the wall clock", varying=True),
    Field("ticks", "ticks", "ticks flown"),
    Field("sim_time_s", TIME, "simulated time flown"),
    _ARRIVED,
    Field("lost", LOST, "UAVs that are lost at the end of the flight"),
    Field(
        "landed", LANDED, "UAVs that have landed for good: their group left, or their battery was empty", optional=True
    ),
    Field("t_avg_s", TRAVEL_TIME, "mean travel time of the UAVs that arrived, each from its launch"),
    Field("t_max_s", TRAVEL_TIME, "longest travel time of the UAVs that arrived"),
    Field(
        "energy_mean_J",
        ENERGY_TO_ARRIVAL,
        "energy of a UAV until it arrives, or until the end of the flight: mean",
    ),
    Field("energy_std_J", ENERGY_TO_ARRIVAL, "the same energy: standard deviation"),
    Field("energy_end_mean_J", ENERGY, "energy of a UAV until the end of the flight: mean"),
    Field("energy_end_std_J", ENERGY, "the same energy: standard deviation"),
    *_OF_BOTH,
    Field(
        "phi_A_standard_error",
        "m/s",
        "standard error of φ_A by the sampling of pairs; null up to 3,000 UAVs, of which all pairs are measured",
        optional=True,
    ),
    Field(
        "collisions_all",
        COLLISIONS,
        "`collisions` of all UAVs in the air, including those that had arrived or were lost",
    ),
    Field(
        "collisions_at_ticks",
        COLLISIONS,
        "the pairs of `collisions` that were nearer than r_coll at the end of such a tick",
        optional=True,
    ),
    Field(
        "closest_approach_m",
        "m",
        "least distance between two UAVs in the air, also between ticks; null if there were never two in the air",
    ),
    Field(
        "obstacle_hits",
        OBSTACLE_HITS,
        "entries of a UAV into one of `[[obstacles]]`, also between ticks; each UAV and obstacle once",
    ),
    Field(
        "grounded",
        GROUNDED,
        "UAVs that came down to the ground, z = 0, after they had been higher than r_coll and before they arrived; "
        "null in the plane",
        optional=True,
    ),
    Field(
        "altitude_violations",
        ALTITUDE_VIOLATIONS,
        "UAVs that went below `space.floor`, after they had risen above it, and UAVs that went above `space.ceiling`, "
        "before they arrived; each UAV and limit once; null without limits",
        optional=True,
    ),
    Field("speed_max_m_s", SPEED, "highest speed of a UAV on the way"),
    Field("speed_mean_m_s", SPEED, "mean speed of the UAVs on the way"),
    Field("distance_mean_m", DISTANCE, "distance that a UAV flies until it arrives: mean"),
    Field(
        "control_effort",
        "m²/s³",
        "∫‖a‖² dt of a UAV's commands, within the vehicle's limit, until it arrives, or until the end: mean",
    ),
    Field(
        "clipped_uav_ticks",
        "1",
        "commands longer than `vehicle.acceleration_max` that were shortened to it; one for each UAV and tick",
    ),
    Field("trajectory_sha256", "", "hash of the states of all ticks; equal for equal flights"),
    Field("payload_bits.*", PAYLOAD, f"payload {_KIND}, counted once per transmission; and `total`"),
    Field("bits_to_arrival.*", PAYLOAD, "the same until the last arrival, or until the end if some never arrived"),
    Field(
        "wire_bytes",
        "bytes",
        "size of the encoded frames on their way to the radio. Each process sends the frames of its UAVs in batches, "
        "so the size depends on the number of processes; a run that was resumed with another number has a part of each",
    ),
    *(Field(f"radio.{name}", measured, about) for name, measured, about in _OF_LINKS),
    Field("radio.airtime_s", "s", "time that transmissions took, collisions included"),
    Field(
        "radio.clamped",
        "links",
        "links over which a message was sent at places for which the channel's path loss does not hold",
        optional=True,
    ),
    Field("radio.duty_max", "1", "largest share of the time that a node sends", optional=True),
    Field(
        "radio.nodes",
        "",
        "`[node, airtime_s, received_s, energy_J]` of the radio of each UAV, then of each station; null if there are "
        "more than 1000",
        optional=True,
    ),
    Field("radio.handovers", "1", "changes of a UAV from one station to another", optional=True),
    Field(
        "radio.backhaul_bits", PAYLOAD, "models over the wire between stations; no radio carries these", optional=True
    ),
    Field(
        "radio.band_time_Hz_s",
        "Hz·s",
        "spectrum taken, band × time: of each link with `fdma`, else of the airtime",
        optional=True,
    ),
    Field("radio.traffic.*.transmissions", "frames", f"transmissions {_KIND}"),
    Field("radio.traffic.*.payload_bits", PAYLOAD, "payload of that traffic, counted once per transmission"),
    Field("radio.traffic.*.wire_bytes", "bytes", "size of the encoded frames of that traffic, as `wire_bytes`"),
    Field("radio.traffic.*.airtime_s", "s", "time that its transmissions took, collisions included"),
    *(Field(f"radio.traffic.*.{name}", measured, f"for that traffic: {about}") for name, measured, about in _OF_LINKS),
    Field("radio.links_used", "links", "ordered pairs of UAVs between which a message was sent"),
    Field("radio.links", "", "`[source, target, sent, outages]` for each link; null if there are more than 1000"),
    Field(
        "energy_radio_J",
        ENERGY,
        "energy of the UAVs' radios: `energy.radio_W` times the time on air, `receive_W` times that of what is sent to "
        "a UAV, and `idle_W` times the rest",
    ),
    Field(
        "energy_compute_J",
        ENERGY,
        "energy of all controllers: `energy.step_J` for each UAV and tick, lost UAVs apart; and of all trainings: "
        "`training.power_W` times their simulated time",
    ),
    Field(
        "energy_total_J",
        ENERGY,
        "energy of all UAVs until the end of the flight: motion, radio and controllers",
        symbol="energy of all UAVs, whole flight",
    ),
    Field("rounds", "1", "rounds whose average was broadcast"),
    Field(
        "rounds_void",
        "1",
        "rounds in which nothing was broadcast: no model of another UAV arrived, or the rule failed",
    ),
    Field(
        "models_sha256",
        "",
        "hash of the global models that were broadcast, or of the uploads if the UAVs average for themselves; equal "
        "for equal flights, null if none was sent",
    ),
    Field("uploads_silent", "1", "uploads that participants did not send: their models had hardly moved"),
    Field("uploads_late", "1", "uploads delivered after `federation.deadline`, which counted in the next round"),
    Field(
        "rounds_isolated", "1", "rounds in which a UAV received no model of another UAV, summed over UAVs that average"
    ),
    Field(
        "diagnostics.*",
        "",
        "sum of each diagnostic of the controller over ticks and the UAVs on the way, in its unit",
    ),
    Field(
        "diagnostics_mean.*",
        "",
        "mean of each diagnostic of the controller over the same ticks and UAVs, in its unit; of trainings over those "
        "whose last training gave all metrics; null if there are none",
        optional=True,
    ),
    Field("diagnostics_max.*", "", "largest absolute value of each diagnostic of the controller, in its unit"),
    Field("hjb_residual_max", HJB_RESIDUAL, "largest HJB residual |e_H|; null if the controller reports none"),
    Field("fpk_residual_max", FPK_RESIDUAL, "largest FPK residual |e_F|; null if the controller reports none"),
    Field("weight_spread_final", SPREAD, "RMS distance of the UAVs' models from their mean, at the last report"),
    Field("nodes_lost", "nodes", "nodes that were lost in flight"),
    Field("nodes_rejoined", "nodes", "nodes that joined in flight, in the place of a lost node or as a standby"),
    Field("uploads_refused", "models", "uploads that were refused and not averaged"),
    Field(
        "states_refused",
        "states",
        "received states that no UAV can have and that were not used; each sender once per tick",
    ),
    Field("dropped_messages.*", "messages", "messages that the receiver refused, by reason"),
    Field("held_commands", "commands", "late commands, in whose place the last one was held; null in lockstep"),
    Field("realtime", "", "null in lockstep", varying=True),
    Field("realtime.factor", "1", "planned simulated seconds per second of the wall clock", varying=True),
    Field("realtime.deadline_misses", "ticks", "ticks in which a command came late", varying=True),
    Field("realtime.tick_start_jitter_ms.mean", "ms", "delay with which a tick began: mean", varying=True),
    Field("realtime.tick_start_jitter_ms.p99", "ms", "the same delay: 99th percentile", varying=True),
    Field("realtime.tick_start_jitter_ms.max", "ms", "the same delay: maximum", varying=True),
    Field("steered", "", "null if no client could steer"),
    Field("steered.uav_ticks", "1", "commands replaced by those of clients; one for each UAV and tick"),
    Field("steered.replayable", "", "false if a client steered: scenario and seed do not fly it again"),
    Field("until", "", "null without the key `until`", optional=True),
    Field("until.metric", "", "the metric of the key", optional=True),
    Field("until.value", "", "its bound", optional=True),
    Field("until.reached", "", "whether a round reached it", optional=True),
    Field("until.round", "1", "the first round that did; null if none did, as the next ones", optional=True),
    Field("until.time_s", "s", "simulated time at the end of that round", optional=True),
    Field("until.bits", PAYLOAD, "payload of all traffic up to then", optional=True),
    Field("until.airtime_s", "s", "airtime of all traffic up to then", optional=True),
    Field("until.energy_J", ENERGY, "energy of all UAVs up to then: motion, radio and controllers", optional=True),
    Field("waypoints_reached", WAYPOINTS_REACHED, "waypoints that UAVs reached; null without waypoints", optional=True),
    Field(
        "turned_back", TURNED_BACK, "UAVs that turned back with a low battery; null without batteries", optional=True
    ),
    Field(
        "batteries_empty",
        BATTERIES_EMPTY,
        "UAVs whose battery was empty in the air; null without batteries",
        optional=True,
    ),
    Field("groups", "", "null without `[[groups]]`; else the fields of each group, by its name", optional=True),
    Field("groups.*.method", "", "name of its controller", optional=True),
    Field("groups.*.uavs", "UAVs", "number of its UAVs", optional=True),
    *(
        Field(f"groups.*.{key}", measured, f"`{key}` of its UAVs", optional=True)
        for key, measured in (
            ("arrived", ARRIVED),
            ("lost", LOST),
            ("landed", LANDED),
            ("t_avg_s", TRAVEL_TIME),
            ("t_max_s", TRAVEL_TIME),
            ("energy_mean_J", ENERGY_TO_ARRIVAL),
            ("energy_std_J", ENERGY_TO_ARRIVAL),
            ("distance_mean_m", DISTANCE),
            ("control_effort", "m²/s³"),
        )
    ),
    *(
        Field(f"groups.*.{key}", measured, about, optional=True)
        for key, measured, about in (
            ("phi_A", ALIGNMENT, "φ_A of the pairs of its UAVs, over the ticks in which one of them is in the air"),
            ("collisions", COLLISIONS, "`collisions` with at least one of its UAVs"),
            ("collisions_all", COLLISIONS, "`collisions_all` with at least one of its UAVs"),
            (
                "closest_approach_m",
                "m",
                "least distance of two of its UAVs in the air, also between ticks; null if there were never two",
            ),
            ("obstacle_hits", OBSTACLE_HITS, "`obstacle_hits` of its UAVs"),
            ("airtime_s", "s", "time for which its UAVs sent"),
            ("payload_bits.*", PAYLOAD, f"payload that its UAVs sent, {_KIND}; and `total`"),
            ("bits_to_arrival.*", PAYLOAD, "the same until its last arrival, or until the end if some never arrived"),
            ("diagnostics.*", "", "`diagnostics` of its UAVs, as far as its controller reports them"),
        )
    ),
    Field("telemetry_blocks_dropped", "blocks", "blocks of rows that the ground station did not receive"),
)
VARYING = frozenset(field.key.partition(".")[0] for field in SUMMARY if field.varying)  # names without their dots

# Columns of timeseries.parquet. A row is a tick, the first that of take-off. The diagnostics of the controller lie
# between the two tuples.
POSITION = ("x_m", "y_m", "z_m")
VELOCITY = ("vx_m_s", "vy_m_s", "vz_m_s")
ACCELERATION = ("ax_m_s2", "ay_m_s2", "az_m_s2")
_OF_VECTORS = {
    **{key: Field(key, "m", "position of each UAV, relative to the origin", type="float64[]") for key in POSITION},
    **{key: Field(key, "m/s", "velocity of each UAV over ground", type="float64[]") for key in VELOCITY},
    **{
        key: Field(key, "m/s²", "commanded acceleration of each UAV in the tick that led here", type="float32[]")
        for key in ACCELERATION
    },
}


def vectors(dimensions: int) -> tuple[str, ...]:
    """Columns of position, velocity and acceleration, in this order."""
    return (*POSITION[:dimensions], *VELOCITY[:dimensions], *ACCELERATION[:dimensions])


def _before(dimensions: int) -> tuple[Field, ...]:
    return (
        Field("tick", "ticks", "number of the tick", type="int32"),
        Field("sim_time_s", TIME, "simulated time since take-off"),
        *(_OF_VECTORS[key] for key in vectors(dimensions)),
        Field("energy_J", ENERGY, "energy that each UAV has used, also after its arrival", True, "float32[]"),
    )


COLUMNS_BEFORE = _before(PLANE)
IN_SPACE = tuple(_OF_VECTORS[each[-1]] for each in (POSITION, VELOCITY, ACCELERATION))  # columns in space only
_SENT = "payload sent by {}, counted once per transmission"
COLUMNS_AFTER = (
    Field("status", "", "mission status of each UAV", type="uint8[]"),
    Field("uplink_bits", PAYLOAD, _SENT.format("UAVs that upload their model"), True),
    Field("relay_bits", PAYLOAD, _SENT.format("heads of clusters to the leader"), True),
    Field("broadcast_bits", PAYLOAD, _SENT.format("the leader with the global model"), True),
    Field("state_bits", PAYLOAD, _SENT.format("controllers, usually their states"), True),
    Field("deliveries", "messages", "messages delivered over links; a broadcast counts once per receiver", True),
    Field("outages", OUTAGES, "messages lost on links; a broadcast counts once per receiver", True),
    Field(
        "airtime_s", "s", "time that transmissions took; each lasts until its last link has delivered or lost it", True
    ),
    *_OF_BOTH,
    _ARRIVED,
    Field("round", "1", "rounds whose average was broadcast", True),
    Field("held_commands", "commands", "late commands, in whose place the last one was held, in real time", True),
    Field("deadline_misses", "ticks", "ticks in which a command came late, in real time", True),
    Field("weight_spread", SPREAD, "RMS distance of the UAVs' models from their mean; null between reports"),
    Field("leader_model", "1", "the reported model of the leader's UAV; null between reports", type="float32[]"),
)
assert tuple(column.key for column in COLUMNS_AFTER[1 : 1 + len(SWARM_COLUMNS)]) == SWARM_COLUMNS
RESERVED = frozenset(column.key for column in (*_before(SPACE), *COLUMNS_AFTER))

DERIVED = (  # numbers that studies make of summaries and time series
    Field("t_s", TIME, "simulated time since take-off"),
    Field(
        "t_avg_censored_s",
        TRAVEL_TIME_OF_ALL,
        "travel time, mean of the UAVs; one that never arrived counts with the duration",
    ),
    Field("energy_trip_mean_J", ENERGY_TO_ARRIVAL, "energy of a UAV so far, at most until it arrives: mean"),
    Field("phi_A_tavg", ALIGNMENT, "alignment φ_A at T_avg", symbol="φ_A(T_avg)"),
    Field("phi_C_tavg", RISK_PRINTED, "collision risk φ_C as printed at T_avg", symbol="φ_C(T_avg)"),
    Field("payload_bits.total", PAYLOAD, "payload of all traffic, counted once per transmission"),
    Field("bits", PAYLOAD, "payload of all traffic so far"),
    Field("last_round.round", "1", "number of the last averaged round; null if no round was averaged"),
    Field("last_round.bits", PAYLOAD, "payload of all traffic from take-off to the end of that round"),
    Field("last_round.airtime_s", "s", "time that all transmissions took from take-off to the end of that round"),
    Field(
        "last_round.mean_*",
        "",
        "mean of each diagnostic at the end of that round over the UAVs on the way; of trainings over those whose last "
        "training gave all metrics",
    ),
    Field("last_round.metric_*", "", "what the learners reported at the end of that round"),
    Field("learner", "", "name of the learner; null without one"),
)


def diagnostic(name: str) -> Field:
    """The column of a diagnostic or of a number that a vehicle shows. That of a plug-in has a name and no unit."""
    if name in SHOWN:
        return Field(name, *SHOWN[name], type="float32[]")
    quantity = DIAGNOSTICS.get(name)
    about = f"{quantity.name} of each UAV" if quantity else f"{name} of controller or vehicle, for each UAV"
    return Field(name, quantity or "", f"{about}, in the tick that led here; 0 at take-off", type="float32[]")


def columns(diagnostics: Iterable[str], dimensions: int = PLANE) -> tuple[Field, ...]:
    """All columns of a run whose controller and vehicle report these diagnostics."""
    return (*_before(dimensions), *map(diagnostic, diagnostics), *COLUMNS_AFTER)


def check_columns(label: str, names: Iterable[str]) -> None:
    """Accepts diagnostics of a controller, or columns of a vehicle, that can be columns of the time series.

    Raises:
        BadInput: one is called like another column; the text begins with `label`.
    """
    if taken := sorted(RESERVED & set(names)):
        raise BadInput(f"{label} {', '.join(taken)}: the time series has columns of that name; give it another")


_BY_KEY = {field.key: field for field in (*SUMMARY, *columns((*DIAGNOSTICS, *SHOWN), SPACE), *DERIVED)}
# The quantity of every field that has one.
FIELDS = {key: field.measured for key, field in _BY_KEY.items() if isinstance(field.measured, Quantity)} | REPORTED


def field(key: str) -> Field:
    """The field of a key of the registry."""
    return _BY_KEY[key]


def quantity(key: str) -> Quantity:
    """The quantity of a field; one that is not registered is called by its own name."""
    return FIELDS.get(key) or Quantity(key)


def axis_label(key: str) -> str:
    """Symbol and unit of a field: `φ_A (m/s)`; of one that is not registered its name, which carries its unit."""
    if key not in FIELDS:
        return key
    named, field = FIELDS[key], _BY_KEY.get(key)
    return f"{(field and field.symbol) or named.symbol or named.name} ({named.unit or '1'})"


def full_label(key: str) -> str:
    """Name and unit of a registered field, for an axis or a column without a title: `alignment φ_A (m/s)`."""
    named, field = FIELDS[key], _BY_KEY.get(key)
    return f"{(field and field.symbol) or named.name} ({named.unit or '1'})"


def table_column(key: str) -> str:
    """The name of a field as the column of a CSV file, where names end in the unit: `phi_A_m_s`."""
    name, unit = key.removesuffix(".total"), quantity(key).unit.replace("/", "_")
    return name if name.endswith(unit) else f"{name}_{unit.lower()}"


def number(summary: Mapping[str, Any], key: str) -> float:
    """A number of a summary by its dotted key; NaN where it is null.

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


def with_unit(key: str) -> str:
    """A key of a scenario with its unit in brackets, if it has one: `wind.drag (1/s)`."""
    described = keys_of(Scenario).get(key)
    return f"{key} ({described.unit})" if described and described.unit else key
