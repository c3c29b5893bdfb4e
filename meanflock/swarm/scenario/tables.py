"""The tables of a scenario: every number with its unit, its bounds and the paper's value as default."""

import math
from typing import Annotated, Any, Literal, NamedTuple, TypeAlias

import numpy as np
from msgspec import Meta, field

from meanflock.swarm.scenario.described import OURS, PRINTED, SILENT, key
from meanflock.swarm.state import Floats
from meanflock.swarm.toml import Table as _Table

# Number format of a model, see federation/coding.py.
Payload: TypeAlias = Literal["float64", "float32", "float16", "int8"]
Places: TypeAlias = tuple[tuple[float, float], ...]


class Start(_Table, frozen=True):
    """Start position, launch time and altitude of every UAV. All start at rest."""

    formation: (
        Annotated[
            Literal["grid", "circle", "streams", "waves"],
            key(
                "formation in which the UAVs start; unset: a grid",
                PRINTED,
                "a square whose rows are filled in order; other missions use circle, streams and waves",
                later=True,
            ),
        ]
        | None
    ) = None
    centre: Annotated[tuple[float, float], key("centre of the formation", PRINTED, "", unit="m")] = (150.0, 100.0)
    spacing: Annotated[
        float,
        key(
            "distance of neighbours in grid, waves and streams",
            PRINTED,
            "√2 m; the paper leaves the initial velocity open, ours is 0",
            unit="m",
            gt=0,
        ),
    ] = math.sqrt(2.0)
    radius: Annotated[
        float,
        key(
            "radius of the circle; for streams, their distance from the crossing at the start",
            OURS,
            "position swaps of this size are common in work on collision avoidance",
            unit="m",
            later=True,
            gt=0,
        ),
    ] = 25.0
    positions: Annotated[
        Places,
        key(
            "start position of each UAV, instead of a formation",
            OURS,
            "for a mission of your own",
            unit="m",
            later=True,
        ),
    ] = ()
    group: Annotated[
        int,
        key(
            "number of UAVs in a wave; they leave at the same time",
            OURS,
            "no effect if all leave at once, except in the formation `waves`",
            unit="UAVs",
            later=True,
            ge=1,
        ),
    ] = 5
    interval: Annotated[
        float,
        key(
            "time between two waves; 0: all UAVs leave at once",
            PRINTED,
            "all UAVs leave at once",
            unit="s",
            later=True,
            ge=0,
            le=1000000.0,
        ),
    ] = 0.0
    height: Annotated[
        float, key("constant altitude h", PRINTED, "constant; it does not affect the model", unit="m", gt=0)
    ] = 40.0


class Destination(_Table, frozen=True):
    """Goals of the UAVs: the origin for all, or a goal for each."""

    radius: Annotated[
        float,
        key(
            "s_dest: a UAV has arrived when ‖s‖ relative to its goal is at most this",
            SILENT,
            "the norm is as printed, although it adds m and m/s",
            unit="m, m/s",
            gt=0,
        ),
    ] = 5.0
    goals: (
        Annotated[
            Literal["common", "opposite", "across", "parallel"],
            key(
                "goals: `common`: the origin; `opposite`: the point opposite the start, through the centre; `across`: "
                "the far side of the crossing; `parallel`: the origin plus the offset of the start from `centre`",
                PRINTED,
                "all UAVs have one destination",
                later=True,
            ),
        ]
        | None
    ) = None
    positions: Annotated[
        Places, key("the goal of each UAV, instead of `goals`", OURS, "for a mission of your own", unit="m", later=True)
    ] = ()


class Obstacle(_Table, frozen=True):
    """A disc that no UAV should enter. A UAV that enters it is counted once and flies on."""

    centre: Annotated[tuple[float, float], Meta(description="its centre, m")]
    radius: Annotated[float, Meta(gt=0, description="its radius, m")]


class Wind(_Table, frozen=True):
    """The Ornstein–Uhlenbeck wind."""

    sigma: Annotated[
        float,
        key(
            "σ_wind, diffusion of velocity",
            PRINTED,
            "it multiplies dW, so it is a standard deviation; the paper calls it a covariance",
            unit="m/s/√s",
            ge=0,
        ),
    ] = 0.1
    mean: Annotated[tuple[float, float], key("v_o, mean wind", PRINTED, "", unit="m/s")] = (1.0, -1.0)
    drag: Annotated[float, key("c0, drag towards the mean wind", PRINTED, "", unit="1/s", ge=0)] = 0.1
    common: Annotated[
        float,
        key(
            "share of the variance of the wind's noise that all UAVs have in common",
            SILENT,
            "the noise of each UAV is independent of that of all others",
            later=True,
            ge=0,
            le=1,
        ),
    ] = 0.0
    field_rms: Annotated[
        float,
        key(
            "RMS speed of a steady wind field that is added to the mean wind; 0: no field",
            PRINTED,
            "the wind is the same everywhere",
            unit="m/s",
            later=True,
            ge=0,
        ),
    ] = 0.0
    field_length: Annotated[
        float, key("length over which that field varies", OURS, "no effect without a field", unit="m", later=True, gt=0)
    ] = 30.0
    field_modes: Annotated[
        int,
        key(
            "number of waves whose sum is the field",
            OURS,
            "so many that no single wave is visible",
            later=True,
            ge=1,
            le=1000,
        ),
    ] = 64


class Truth(_Table, frozen=True):
    """Drag and wind of the world, if they differ from `[wind]`. UAVs know `[wind]` only."""

    drag: (
        Annotated[
            float,
            key("drag of the world, instead of `wind.drag`", PRINTED, "the UAVs are told the truth", unit="1/s", ge=0),
        ]
        | None
    ) = None
    wind: (
        Annotated[
            tuple[float, float], key("mean wind of the world, instead of `wind.mean`", PRINTED, "likewise", unit="m/s")
        ]
        | None
    ) = None


class SharingRule(NamedTuple):
    """Rule by which a UAV broadcasts its state.

    broadcast: every tick, or at events. delta_m: error of the predicted position that makes an event, m.
    velocity_delta_m_s: the same for the velocity; 0: the velocity makes no events, m/s. repeats: number of consecutive
    ticks in which an event is sent.
    """

    broadcast: Literal["tick", "event"]
    delta_m: float
    velocity_delta_m_s: float
    repeats: int


POLICIES = {
    "tick": SharingRule("tick", 0.3, 0.0, 1),
    "event": SharingRule("event", 0.3, 0.0, 1),
    "event-4": SharingRule("event", 0.3, 0.2, 4),
}


class Sharing(_Table, frozen=True):
    """Broadcasts of states by controllers that share states, and by filters."""

    policy: Annotated[
        Literal["tick", "event", "event-4"],
        key(
            "`tick`: every tick; `event`: if others predict the position too badly; `event-4`: or the velocity, and "
            "four times. Each of the keys below changes one part of it",
            OURS,
            "collision-free also if a third of the messages is lost, with a tenth of the bits sent by `tick`",
        ),
    ] = "event-4"
    broadcast: (
        Annotated[
            Literal["tick", "event"],
            key(
                "`tick`: four floats every tick; `event`: 64 bits if others predict the state too badly; unset: the "
                "policy's",
                OURS,
                "",
            ),
        ]
        | None
    ) = None
    delta_m: (
        Annotated[
            float,
            key(
                "δ, error of the position that others predict above which an event is sent; unset: the policy's",
                OURS,
                "below half of the distance that a filter maintains",
                unit="m",
                gt=0,
            ),
        ]
        | None
    ) = None
    velocity_delta_m_s: (
        Annotated[
            float,
            key(
                "the same for the velocity; 0: only the position causes an event; unset: the policy's",
                OURS,
                "",
                unit="m/s",
                ge=0,
            ),
        ]
        | None
    ) = None
    repeats: (
        Annotated[
            int,
            key(
                "r, number of consecutive ticks in which an event is sent; unset: the policy's",
                OURS,
                "enough if a third of the messages is lost",
                unit="ticks",
                ge=1,
                le=16,
            ),
        ]
        | None
    ) = None
    forget_s: Annotated[
        float,
        key(
            "with a broadcast every tick: a UAV that was not received for this long is ignored",
            OURS,
            "longer than a series of losses, shorter than a flight across the formation",
            unit="s",
            gt=0,
        ),
    ] = 5.0

    @property
    def rule(self) -> SharingRule:
        """The policy, changed by the keys that are set."""
        changes = {key: value for key in SharingRule._fields if (value := getattr(self, key)) is not None}
        return POLICIES[self.policy]._replace(**changes)


class FilterTable(_Table, frozen=True):
    """Filter that may change the accelerations of any controller."""

    kind: Annotated[
        str,
        key(
            "the filter, see `meanflock plugins`; `none`: commands are flown as the controller gives them",
            OURS,
            "the paper has no collision avoidance",
        ),
    ] = "none"
    options: Annotated[dict[str, Any], key("options of that filter", OURS, "a filter declares its own")] = field(
        default_factory=dict
    )


class Federation(_Table, frozen=True):
    """Rounds in which the UAVs share their models."""

    period: (
        Annotated[
            int,
            key(
                "n0, ticks between rounds; unset: the number that the controller declares",
                PRINTED,
                "100 for H and F, 200 for HF; one sentence of the paper has 100 for all",
                unit="ticks",
                ge=1,
            ),
        ]
        | None
    ) = None
    fraction: Annotated[float, key("N_h / N, share of the UAVs that upload in a round", PRINTED, "", gt=0, le=1)] = 0.8
    leader: Annotated[int, key("h, the UAV that carries the leader", SILENT, "any UAV will do", ge=0)] = 0
    state_period: Annotated[
        int,
        key(
            "n_s, ticks between broadcasts of the state by `mfg`; 0: initial states only",
            SILENT,
            "the paper does not say how often `mfg` shares states; 0 shares the initial ones only",
            unit="ticks",
            ge=0,
        ),
    ] = 0
    aggregation: Annotated[
        str,
        key(
            "aggregation rule, by which the leader makes one model of many; see `meanflock plugins`",
            PRINTED,
            "FedAvg",
            later=True,
        ),
    ] = "fedavg"
    options: Annotated[dict[str, Any], key("options of that rule", OURS, "a rule declares its own", later=True)] = (
        field(default_factory=dict)
    )
    tolerance: Annotated[
        float,
        key(
            "share of the uploads that `trimmed-mean` and `krum` assume to be false",
            OURS,
            "a quarter of the uploads may be false",
            later=True,
            ge=0,
            lt=0.5,
        ),
    ] = 0.25
    byzantine_fraction: Annotated[
        float, key("share of the UAVs whose uploads are false", OURS, "all uploads are true", later=True, ge=0, le=1)
    ] = 0.0
    byzantine_kind: Annotated[
        Literal["huge", "sign-flip", "boost", "noise"],
        key("content of a false upload", OURS, "no effect if all uploads are true", later=True),
    ] = "sign-flip"
    payload: (
        Annotated[
            Payload,
            key(
                "number format of uploads; unset: the radio's floats",
                OURS,
                "the paper's floats; narrower ones are measured in [communication](communication.md)",
                later=True,
            ),
        ]
        | None
    ) = None
    broadcast_payload: (
        Annotated[
            Payload, key("number format of the global model; unset: the radio's floats", OURS, "likewise", later=True)
        ]
        | None
    ) = None
    error_feedback: Annotated[
        bool,
        key(
            "add the rounding error of an upload to the same UAV's next upload",
            OURS,
            "without it rounding errors add up; see [communication](communication.md)",
            later=True,
        ),
    ] = True
    deadline: (
        Annotated[
            float,
            key(
                "time after which a round is averaged; later uploads count in the next one; unset: the latency "
                "threshold, after which an upload is lost, s",
                OURS,
                "on the paper's radio an upload takes 0.4 ms at most, so none is late",
                later=True,
                gt=0,
            ),
        ]
        | None
    ) = None
    fragment: (
        Annotated[
            int,
            key(
                "slots of a fragment into which models are cut; 0: models are never cut; unset: models that need more "
                "than the latency threshold are cut into the longest fragments of which 95 % arrive",
                OURS,
                "the paper's models fit into one message; [federation](federation.md) says what longer ones do",
                later=True,
                ge=0,
            ),
        ]
        | None
    ) = None
    upload_threshold: Annotated[
        float,
        key(
            "a UAV uploads only if its model has moved by more than this share of the model that it sent last; 0: in "
            "every round",
            OURS,
            "the paper's UAVs upload in every round",
            later=True,
            ge=0,
        ),
    ] = 0.0
    range_m: (
        Annotated[
            float,
            key(
                "distance that uploads, relays and global models reach; unset: any distance",
                PRINTED,
                "the paper's uploads and global models reach any distance",
                unit="m",
                later=True,
                gt=0,
            ),
        ]
        | None
    ) = None
    topology: (
        Annotated[
            str,
            key(
                "topology, see `meanflock plugins`; unset: `leader`, or `clusters` if K > 1",
                OURS,
                "one leader averages all models",
                later=True,
            ),
        ]
        | None
    ) = None
    clusters: Annotated[
        int,
        key(
            "K, number of clusters whose heads average for the leader; 1: no clusters",
            OURS,
            "one leader for all UAVs; [scaling](scaling.md) says what clusters cost and save",
            later=True,
            ge=1,
        ),
    ] = 1


class Radio(_Table, frozen=True):
    """The Rician FDMA link and its accounting."""

    tx_power_dbm: Annotated[float, key("P_o, power of a transmitter", PRINTED, "", unit="dBm", ge=-300, le=300)] = 20.0
    bandwidth_hz: Annotated[
        float, key("W_o, bandwidth of a link", PRINTED, "", unit="Hz", ge=1, le=1000000000000000.0)
    ] = 2e6
    noise_psd_dbm_hz: Annotated[
        float, key("σ_n, power density of the noise", PRINTED, "", unit="dBm/Hz", ge=-300, le=300)
    ] = -110.0
    path_loss_exponent: Annotated[
        float,
        key(
            "α, exponent of the path loss",
            PRINTED,
            "with α = 0 all links are alike, whatever their length. The paper's equations ask for α ≥ 2, its list of "
            "parameters has 0",
            ge=0,
        ),
    ] = 0.0
    rice_xi: Annotated[float, key("ξ, strength of the line of sight", PRINTED, "", ge=0)] = 6.649
    rice_chi: Annotated[float, key("χ, strength of the scattered paths", PRINTED, "", gt=0)] = 1.347
    fading: Annotated[
        Literal["amplitude", "power"],
        key(
            "SNR ∝ z, as printed, or ∝ z²", PRINTED, "the paper multiplies the SNR by an amplitude; `power` squares it"
        ),
    ] = "amplitude"
    target_snr_db: Annotated[
        float,
        key(
            "η, SNR below which a slot carries nothing",
            SILENT,
            "printed power, noise and fading give a median SNR of 75.3 dB at every distance, because α = 0; with a "
            "target near this median the radio loses long models sometimes and short ones rarely",
            unit="dB",
            ge=-300,
            le=300,
        ),
    ] = 75.0
    coherence_time_s: Annotated[
        float,
        key("θ, length of a slot", SILENT, "chosen together with `radio.target_snr_db`", unit="s", ge=1e-09, le=1000.0),
    ] = 5e-5
    latency_threshold_slots: Annotated[
        int, key("D_M, slots after which a message is lost", SILENT, "likewise", unit="slots", ge=1, le=1000000)
    ] = 8
    bits_per_float: Annotated[
        Literal[16, 32, 64],
        key("width of a float on the radio", SILENT, "b in the paper's formula of the payload", unit="bit"),
    ] = 32
    range_m: Annotated[
        float,
        key(
            "distance that a broadcast of a UAV reaches",
            PRINTED,
            "the reach of the states that `hjb` sends",
            unit="m",
            gt=0,
        ),
    ] = 100.0
    plausible_speed: Annotated[
        float,
        key(
            "received states that are faster, or farther away than this speed allows, are not used",
            OURS,
            "far above the speeds flown here; [robustness](robustness.md#false-states) measures false states below it",
            unit="m/s",
            later=True,
            gt=0,
        ),
    ] = 100.0
    model: Annotated[str, key("the channel, see `meanflock plugins`", PRINTED, "", later=True)] = "rice"
    options: Annotated[
        dict[str, Any], key("options of that channel", OURS, "a channel declares its own", later=True)
    ] = field(default_factory=dict)

    @property
    def bits_per_slot(self) -> float:
        """θ W_o log₂(1 + η): what a slot carries if its SNR reaches the target."""
        return self.coherence_time_s * self.bandwidth_hz * math.log2(1.0 + 10.0 ** (self.target_snr_db / 10.0))


class VehicleTable(_Table, frozen=True):
    """Vehicle, and constants of the rotary-wing power model, as printed: a craft of a few grams."""

    model: Annotated[
        str,
        key(
            "the vehicle, see `meanflock plugins`",
            PRINTED,
            "double integrator in wind, power of a rotary wing",
            later=True,
        ),
    ] = "point-mass"
    options: Annotated[
        dict[str, Any], key("options of that vehicle", OURS, "a vehicle declares its own", later=True)
    ] = field(default_factory=dict)
    acceleration_max: (
        Annotated[
            float,
            key(
                "limit of the acceleration that a UAV can command; unset: no limit",
                PRINTED,
                "the paper's vehicle has no limit; the leaderboard flies at 6 m/s²",
                unit="m/s²",
                later=True,
                ge=0,
            ),
        ]
        | None
    ) = None
    blade_power: Annotated[
        float,
        key(
            "λ0, profile power of the blades",
            PRINTED,
            "a vehicle of about five grams, which hovers with 0.094 W",
            unit="W",
            ge=0,
        ),
    ] = 0.0049
    induced_power: Annotated[float, key("λ1, induced power in hover", PRINTED, "likewise", unit="W", ge=0)] = 0.0887
    power_speed: Annotated[
        Literal["ground", "air"],
        key(
            "speed that determines the power: over ground, or through the air",
            PRINTED,
            "with `ground`, as printed, drifting with the wind is free; with `air` it costs power",
            later=True,
        ),
    ] = "ground"
    parasite_drag: Annotated[float, key("λ2, parasite drag", PRINTED, "likewise", unit="W s³/m³", ge=0)] = 0.0092
    tip_speed: Annotated[float, key("ω_tip, speed of the blades' tips", PRINTED, "likewise", unit="m/s", gt=0)] = 15.0
    induced_velocity: Annotated[float, key("χ_o, induced velocity in hover", PRINTED, "likewise", unit="m/s", gt=0)] = (
        1.612
    )

    def power(self, squared: Floats, speed: Floats) -> Floats:
        """Blade profile + induced + parasite power in W, Eq. Power1, at speeds in m/s and their squares; same shape."""
        blade = self.blade_power * (1.0 + 3.0 * squared / self.tip_speed**2)
        # √(1+u²) − u = 1/(√(1+u²) + u): the printed form loses all digits at high speed
        induced = squared / (2.0 * self.induced_velocity**2)
        lift = self.induced_power / np.sqrt(np.sqrt(1.0 + induced * induced) + induced)
        return blade + lift + self.parasite_drag * squared * speed / 2.0


class Energy(_Table, frozen=True):
    """Energy of the radio and of the computer; it is in the summary only."""

    radio_W: Annotated[
        float,
        key(
            "power of a transmitter, times its time on air",
            OURS,
            "the paper counts the energy of motion only",
            unit="W",
            ge=0,
        ),
    ] = 0.0
    step_J: Annotated[
        float, key("energy of one tick of the controller of one UAV", OURS, "likewise", unit="J", ge=0)
    ] = 0.0


class Metrics(_Table, frozen=True):
    """Radii of the collision metrics."""

    collision_radius: Annotated[
        float,
        key(
            "r_coll, distance below which a pair collides",
            PRINTED,
            "a pair counts once, while both are on the way",
            unit="m",
            gt=0,
        ),
    ] = 0.1
    hazard_radius: Annotated[
        float, key("r_C, distance below which a pair counts for the risk φ_C", PRINTED, "√2/2 m", unit="m", gt=0)
    ] = math.sqrt(2.0) / 2.0


class Pace(_Table, frozen=True):
    """Limits of the time that all others wait for one node (wall clock, in lockstep), and of rejoins."""

    slow_s: Annotated[
        float,
        key(
            "a reply is slow if it takes longer than this, and longer than `slow_factor` allows",
            OURS,
            "far above what a healthy node takes",
            unit="s",
            gt=0,
        ),
    ] = 2.0
    slow_factor: Annotated[
        float,
        key(
            "a reply is slow if it takes longer than this many times the median of all nodes",
            OURS,
            "if all nodes are slow, no node is to blame",
            ge=1,
        ),
    ] = 10.0
    slow_ticks: Annotated[
        int,
        key(
            "number of slow replies after which a node is lost; one is forgiven every 100 ticks",
            OURS,
            "spares a node that is slow now and then",
            ge=1,
        ),
    ] = 50
    wait_share: Annotated[
        float,
        key(
            "share of the wall time that all others may wait for one agent alone",
            OURS,
            "one agent slows a flight by a quarter at most; an agent may always cost its share of the UAVs",
            later=True,
            gt=0,
            le=1,
        ),
    ] = 0.2
    wait_window_s: Annotated[
        float,
        key(
            "window over which that share is measured; an agent that exceeds it stays out for as long",
            OURS,
            "longer than any pause of a healthy machine",
            unit="s",
            later=True,
            ge=1,
            le=1000000.0,
        ),
    ] = 60.0
    rejoins: Annotated[
        int,
        key(
            "number of rejoins within `rejoin_ticks` after which a node is refused for good",
            OURS,
            "as often as `meanflock run` restarts a process",
            later=True,
            ge=1,
            le=1000,
        ),
    ] = 5
    rejoin_ticks: Annotated[
        int, key("ticks of the window of that limit", OURS, "a minute of flight", unit="ticks", later=True, ge=1)
    ] = 600
