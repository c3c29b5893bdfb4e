"""Every field of `summary.json` and every kind of event of `events.jsonl`: what docs/data.md is made of."""

from typing import NamedTuple


class Field(NamedTuple):
    """A field by its dotted key, `*` for any name. unit: `1` for a number without one, empty for what is none."""

    key: str
    unit: str
    about: str


_OBSERVED = (
    ("sent", "messages", "messages sent over links; a broadcast counts once for each receiver"),
    ("delivered", "messages", "messages delivered"),
    ("outages", "messages", "messages given up, see outage in the glossary"),
    ("outage_rate", "1", "outages / sent"),
    ("outage_rate_theory", "1", "closed form of the outage rate at the distances flown"),
    ("latency_slots_mean", "slots", "mean latency of what was delivered"),
    ("latency_slots_mean_theory", "slots", "closed form of the mean latency at the distances flown"),
)
_OF_TRAFFIC = "of a kind of traffic: uplink, relay, broadcast or state"

SUMMARY = (
    Field("schema", "1", "version of this record"),
    Field("run_id", "", "name of the run"),
    Field("version", "", "version of meanflock"),
    Field("scenario_sha256", "", "hash of the resolved scenario; equal for equal scenarios"),
    Field("method", "", "name of the controller"),
    Field("uavs", "UAVs", "number of UAVs"),
    Field("seed", "1", "seed of all randomness"),
    Field("mode", "", "`processes`, or `in-process` where all nodes were in one"),
    Field("backend", "", "whether the kernels of the world were `compiled` or `numpy`"),
    Field("wall_time_s", "s", "how long the flight took"),
    Field("real_time_factor", "1", "simulated seconds a second"),
    Field("ticks", "ticks", "ticks flown"),
    Field("sim_time_s", "s", "simulated time flown"),
    Field("arrived", "UAVs", "UAVs that arrived"),
    Field("lost", "UAVs", "UAVs that are lost at the end"),
    Field("t_avg_s", "s", "mean travel time, each from its launch, of the UAVs that arrived"),
    Field("t_max_s", "s", "longest travel time of the UAVs that arrived"),
    Field("energy_mean_J", "J", "energy until own arrival, or the end: mean of the UAVs"),
    Field("energy_std_J", "J", "the same: standard deviation"),
    Field("energy_end_mean_J", "J", "energy until the end of the flight: mean of the UAVs"),
    Field("energy_end_std_J", "J", "the same: standard deviation"),
    Field("phi_A", "m/s", "alignment φ_A: mean difference of velocities, lower is better"),
    Field("phi_C", "1", "collision risk φ_C as printed, with self-pairs"),
    Field("phi_C_distinct", "1", "collision risk φ_C: share of distinct pairs nearer than r_C at ticks"),
    Field("collisions", "pairs", "pairs that came nearer than r_coll in a tick that both began on the way, each once"),
    Field("collisions_all", "pairs", "the same of all UAVs in the air, also those that had arrived or were lost"),
    Field(
        "closest_approach_m",
        "m",
        "least distance of any two in the air, between ticks too; null where there never were two",
    ),
    Field("obstacle_hits", "1", "UAVs that entered a disc of `[[obstacles]]`, between ticks too, each disc once"),
    Field("speed_max_m_s", "m/s", "highest speed of any UAV on the way"),
    Field("speed_mean_m_s", "m/s", "mean speed on the way"),
    Field("distance_mean_m", "m", "distance flown until own arrival: mean of the UAVs"),
    Field("control_effort", "m²/s³", "∫‖a‖² dt of the commands until own arrival, or the end: mean of the UAVs"),
    Field("trajectory_sha256", "", "hash of the states of all ticks; equal for equal flights"),
    Field("payload_bits.*", "bit", f"payload {_OF_TRAFFIC}, once a transmission; and `total`"),
    Field("bits_to_arrival.*", "bit", "the same until the last arrival; where some never arrived, until the end"),
    Field("wire_bytes", "bytes", "encoded frames as they crossed the bus on the way to the radio"),
    *(Field(f"radio.{name}", unit, about) for name, unit, about in _OBSERVED),
    Field("radio.airtime_s", "s", "time transmissions took"),
    Field("radio.traffic.*.transmissions", "frames", f"transmissions {_OF_TRAFFIC}"),
    Field("radio.traffic.*.payload_bits", "bit", "payload of that traffic, once a transmission"),
    Field("radio.traffic.*.wire_bytes", "bytes", "encoded frames of that traffic"),
    Field("radio.traffic.*.airtime_s", "s", "time its transmissions took"),
    *(Field(f"radio.traffic.*.{name}", unit, f"of that traffic: {about}") for name, unit, about in _OBSERVED),
    Field("radio.links_used", "links", "pairs of UAVs, with direction, that any message was sent between"),
    Field("radio.links", "", "`[source, target, sent, outages]` of each link; null where there are more than 1000"),
    Field("rounds", "1", "rounds averaged and broadcast"),
    Field("rounds_void", "1", "rounds that had no model of another UAV to average, so that nothing was broadcast"),
    Field(
        "diagnostics.*",
        "",
        "sum of each diagnostic the controller reports, over UAVs on the way and ticks, in its unit",
    ),
    Field("diagnostics_max.*", "", "largest size of each diagnostic the controller reports, in its unit"),
    Field("hjb_residual_max", "m/s", "largest HJB residual |e_H|; null where the controller reports none"),
    Field("fpk_residual_max", "1/s", "largest FPK residual |e_F|; null where the controller reports none"),
    Field("weight_spread_final", "1", "RMS distance of what the UAVs have learned from its mean, at the last report"),
    Field("nodes_lost", "nodes", "nodes lost in flight"),
    Field("nodes_rejoined", "nodes", "nodes admitted in flight, in the place of a lost one or as a standby"),
    Field("uploads_refused", "models", "uploads that were not averaged because they could not be used"),
    Field(
        "states_refused",
        "states",
        "received states that were not used because no UAV can have them, each sender once a tick",
    ),
    Field("dropped_messages.*", "messages", "messages that were refused on receipt, by reason"),
    Field("held_commands", "commands", "commands held over because they came late; null in lockstep"),
    Field("realtime", "", "null in lockstep"),
    Field("realtime.factor", "1", "how many times faster than the wall clock ticks were due"),
    Field("realtime.deadline_misses", "ticks", "ticks in which any command came late"),
    Field("realtime.tick_start_jitter_ms.mean", "ms", "how long after its time a tick began: mean"),
    Field("realtime.tick_start_jitter_ms.p99", "ms", "the same: 99th percentile"),
    Field("realtime.tick_start_jitter_ms.max", "ms", "the same: maximum"),
    Field("telemetry_blocks_dropped", "blocks", "blocks of rows the ground station did not get"),
)

_FLIGHTS = "a number a seed, in their order; null where a flight has none"

LEADERBOARD = (  # of `leaderboard.json`: a course is a mission as flown, a standing a row of its table
    Field("schema", "1", "version of this record"),
    Field("version", "", "version of meanflock"),
    Field("code", "", "version and fingerprint of the code that flew"),
    Field("seeds", "1", "seeds of every row"),
    Field("courses.name", "", "name of the mission"),
    Field("courses.title", "", "what its table is headed with"),
    Field("courses.about", "", "the mission in words"),
    Field("courses.uavs", "UAVs", "number of UAVs"),
    Field("courses.duration_s", "s", "a flight ends at the latest then"),
    Field("courses.absent.*", "", "why a row cannot fly the mission, by the row's name"),
    Field("courses.front_s", "s", "times of the front; empty where it is not known"),
    Field("courses.front_J", "J", "least energy for each of these, mean of the UAVs"),
    Field("courses.standings.name", "", "name of the row"),
    Field("courses.standings.controller", "", "name of its controller"),
    Field("courses.standings.about", "", "the row in words"),
    Field("courses.standings.settings.*", "", "keys of the scenario that the row sets"),
    Field("courses.standings.yours", "", "whether the controller came in a file of the reader's"),
    Field("courses.standings.cells.*.mean", "", "mean of the flights, by measure; shares are of 1"),
    Field("courses.standings.cells.*.low", "", "lower end of its 95 % interval; null where there is none"),
    Field("courses.standings.cells.*.high", "", "upper end"),
    Field("courses.standings.cells.*.n", "flights", "flights it is of"),
    Field("courses.standings.cells.*.best", "", "whether it differs significantly from every other row of the table"),
    Field("courses.standings.cells.*.least", "", "least of all flights; null but for the closest approach"),
    Field("courses.standings.kbit_by_kind.*", "kbit", "payload until the last arrival by kind of traffic, mean"),
    Field("courses.standings.values.*", "", f"of each measure {_FLIGHTS}"),
    Field("courses.standings.lost", "UAVs", "UAVs lost in all flights"),
    Field("courses.standings.failed", "flights", "flights that could not be flown"),
    Field("courses.standings.why", "", "why the first of them, or the first UAV lost"),
)

EVENT = {  # fields of a line
    "tick": "number of the tick",
    "sim_time_s": "its simulated time, s",
    "kind": "one of those below",
    "text": "what happened, in words",
    "uavs": "numbers of the UAVs it is about, if of any",
}
EVENTS = {  # kinds
    "joined": "all nodes are there, the flight begins",
    "resumed": "the flight goes on from a checkpoint",
    "round": "a round was averaged and broadcast",
    "void": "a round, or the part of a cluster in it, came to nothing",
    "leader": "another leader takes over; or what a leader reports when it fails",
    "agent": "what an agent reports when it fails",
    "refused": "uploads not averaged, states not believed (named once; all are counted), or a node not let in again",
    "dropped": "a message was not let in (the first of them); the summary counts all, by reason",
    "slow": "a node keeps the others waiting, tick after tick, and is lost if it goes on",
    "lost": "a node or its UAVs are lost",
    "diverged": "UAVs are lost because their numbers or their controller failed",
    "rejoined": "UAVs that were lost have an agent again, or a standby leader is there",
    "arrived": "UAVs arrived",
    "collision": "two UAVs came nearer than r_coll in the tick that ends here, which both began on the way",
    "hit": "a UAV entered a disc of `[[obstacles]]` for the first time, in the tick that ends here",
    "fault": "the fault script begins or ends something",
    "failed": "every agent was lost and none came back: the flight ends here",
    "finished": "the flight is over",
}
