"""The tables of a scenario: every number with its unit, its bounds and the paper's value as default."""

import math
from typing import Annotated, Any, Literal, NamedTuple, TypeAlias

import numpy as np
from msgspec import Meta, field

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
            Meta(description="formation in which the UAVs start; unset: a grid"),
        ]
        | None
    ) = None
    centre: Annotated[tuple[float, float], Meta(description="centre of the formation, m")] = (150.0, 100.0)
    spacing: Annotated[float, Meta(gt=0, description="distance of neighbours in grid, waves and streams, m")] = (
        math.sqrt(2.0)
    )
    radius: Annotated[
        float,
        Meta(gt=0, description="radius of the circle; for streams, their distance from the crossing at the start, m"),
    ] = 25.0
    positions: Annotated[Places, Meta(description="start position of each UAV, instead of a formation, m")] = ()
    group: Annotated[int, Meta(ge=1, description="number of UAVs in a wave; they leave at the same time")] = 5
    interval: Annotated[
        float, Meta(ge=0, le=1e6, description="time between two waves; 0: all UAVs leave at once, s")
    ] = 0.0
    height: Annotated[float, Meta(gt=0, description="constant altitude h, m")] = 40.0


class Destination(_Table, frozen=True):
    """Goals of the UAVs: the origin for all, or a goal for each."""

    radius: Annotated[
        float,
        Meta(gt=0, description="s_dest: a UAV has arrived when ‖s‖ relative to its goal is at most this, m and m/s"),
    ] = 5.0
    goals: (
        Annotated[
            Literal["common", "opposite", "across", "parallel"],
            Meta(
                description="goals: `common`: the origin; `opposite`: the point opposite the start, through the "
                "centre; `across`: the far side of the crossing; `parallel`: the origin plus the offset of the "
                "start from `centre`"
            ),
        ]
        | None
    ) = None
    positions: Annotated[Places, Meta(description="the goal of each UAV, instead of `goals`, m")] = ()


class Obstacle(_Table, frozen=True):
    """A disc that no UAV should enter. A UAV that enters it is counted once and flies on."""

    centre: Annotated[tuple[float, float], Meta(description="its centre, m")]
    radius: Annotated[float, Meta(gt=0, description="its radius, m")]


class Wind(_Table, frozen=True):
    """The Ornstein–Uhlenbeck wind."""

    sigma: Annotated[float, Meta(ge=0, description="σ_wind, diffusion of velocity, m/s/√s")] = 0.1
    mean: Annotated[tuple[float, float], Meta(description="v_o, mean wind, m/s")] = (1.0, -1.0)
    drag: Annotated[float, Meta(ge=0, description="c0, drag towards the mean wind, 1/s")] = 0.1
    common: Annotated[
        float, Meta(ge=0, le=1, description="share of the variance of the wind's noise that all UAVs have in common")
    ] = 0.0
    field_rms: Annotated[
        float,
        Meta(ge=0, description="RMS speed of a steady wind field that is added to the mean wind; 0: no field, m/s"),
    ] = 0.0
    field_length: Annotated[float, Meta(gt=0, description="length over which that field varies, m")] = 30.0
    field_modes: Annotated[int, Meta(ge=1, le=1000, description="number of waves whose sum is the field")] = 64


class Truth(_Table, frozen=True):
    """Drag and wind of the world, if they differ from `[wind]`. UAVs know `[wind]` only."""

    drag: Annotated[float, Meta(ge=0, description="drag of the world, instead of `wind.drag`, 1/s")] | None = None
    wind: (
        Annotated[tuple[float, float], Meta(description="mean wind of the world, instead of `wind.mean`, m/s")] | None
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
        Meta(
            description="`tick`: every tick; `event`: if others predict the position too badly; `event-4`: or the "
            "velocity, and four times. Each of the keys below changes one part of it"
        ),
    ] = "event-4"
    broadcast: (
        Annotated[
            Literal["tick", "event"],
            Meta(
                description="`tick`: four floats every tick; `event`: 64 bits if others predict the state too badly; "
                "unset: the policy's"
            ),
        ]
        | None
    ) = None
    delta_m: (
        Annotated[
            float,
            Meta(
                gt=0,
                description="δ, error of the position that others predict above which an event is sent; unset: the "
                "policy's, m",
            ),
        ]
        | None
    ) = None
    velocity_delta_m_s: (
        Annotated[
            float,
            Meta(
                ge=0,
                description="the same for the velocity; 0: only the position causes an event; unset: the policy's, m/s",
            ),
        ]
        | None
    ) = None
    repeats: (
        Annotated[
            int,
            Meta(
                ge=1, le=16, description="r, number of consecutive ticks in which an event is sent; unset: the policy's"
            ),
        ]
        | None
    ) = None
    forget_s: Annotated[
        float,
        Meta(gt=0, description="with a broadcast every tick: a UAV that was not received for this long is ignored, s"),
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
        Meta(
            description="the filter, see `meanflock plugins`; `none`: commands are flown as the controller gives them"
        ),
    ] = "none"
    options: Annotated[dict[str, Any], Meta(description="options of that filter")] = field(default_factory=dict)


class Federation(_Table, frozen=True):
    """Rounds in which the UAVs share their models."""

    period: (
        Annotated[
            int, Meta(ge=1, description="n0, ticks between rounds; unset: the number that the controller declares")
        ]
        | None
    ) = None
    fraction: Annotated[float, Meta(gt=0, le=1, description="N_h / N, share of the UAVs that upload in a round")] = 0.8
    leader: Annotated[int, Meta(ge=0, description="h, the UAV that carries the leader")] = 0
    state_period: Annotated[
        int, Meta(ge=0, description="n_s, ticks between broadcasts of the state by `mfg`; 0: initial states only")
    ] = 0
    aggregation: Annotated[
        str, Meta(description="aggregation rule, by which the leader makes one model of many; see `meanflock plugins`")
    ] = "fedavg"
    options: Annotated[dict[str, Any], Meta(description="options of that rule")] = field(default_factory=dict)
    tolerance: Annotated[
        float, Meta(ge=0, lt=0.5, description="share of the uploads that `trimmed-mean` and `krum` assume to be false")
    ] = 0.25
    byzantine_fraction: Annotated[float, Meta(ge=0, le=1, description="share of the UAVs whose uploads are false")] = (
        0.0
    )
    byzantine_kind: Annotated[
        Literal["huge", "sign-flip", "boost", "noise"],
        Meta(description="content of a false upload"),
    ] = "sign-flip"
    payload: Annotated[Payload, Meta(description="number format of uploads; unset: the radio's floats")] | None = None
    broadcast_payload: (
        Annotated[Payload, Meta(description="number format of the global model; unset: the radio's floats")] | None
    ) = None
    error_feedback: Annotated[
        bool, Meta(description="add the rounding error of an upload to the same UAV's next upload")
    ] = True
    deadline: (
        Annotated[
            float,
            Meta(
                gt=0,
                description="time after which a round is averaged; later uploads count in the next one; unset: the "
                "latency threshold, after which an upload is lost, s",
            ),
        ]
        | None
    ) = None
    fragment: (
        Annotated[
            int,
            Meta(
                ge=0,
                description="slots of a fragment into which models are cut; 0: models are never cut; unset: models "
                "that need more than the latency threshold are cut into the longest fragments of which 95 % arrive",
            ),
        ]
        | None
    ) = None
    upload_threshold: Annotated[
        float,
        Meta(
            ge=0,
            description="a UAV uploads only if its model has moved by more than this share of the model that it sent "
            "last; 0: in every round",
        ),
    ] = 0.0
    range_m: (
        Annotated[
            float,
            Meta(gt=0, description="distance that uploads, relays and global models reach; unset: any distance, m"),
        ]
        | None
    ) = None
    topology: (
        Annotated[
            str,
            Meta(description="topology, see `meanflock plugins`; unset: `leader`, or `clusters` if K > 1"),
        ]
        | None
    ) = None
    clusters: Annotated[
        int, Meta(ge=1, description="K, number of clusters whose heads average for the leader; 1: no clusters")
    ] = 1


class Radio(_Table, frozen=True):
    """The Rician FDMA link and its accounting."""

    tx_power_dbm: Annotated[float, Meta(ge=-300, le=300, description="P_o, power of a transmitter, dBm")] = 20.0
    bandwidth_hz: Annotated[float, Meta(ge=1, le=1e15, description="W_o, bandwidth of a link, Hz")] = 2e6
    noise_psd_dbm_hz: Annotated[
        float, Meta(ge=-300, le=300, description="σ_n, power density of the noise, dBm/Hz")
    ] = -110.0
    path_loss_exponent: Annotated[float, Meta(ge=0, description="α, exponent of the path loss")] = 0.0
    rice_xi: Annotated[float, Meta(ge=0, description="ξ, strength of the line of sight")] = 6.649
    rice_chi: Annotated[float, Meta(gt=0, description="χ, strength of the scattered paths")] = 1.347
    fading: Annotated[Literal["amplitude", "power"], Meta(description="SNR ∝ z, as printed, or ∝ z²")] = "amplitude"
    target_snr_db: Annotated[
        float, Meta(ge=-300, le=300, description="η, SNR below which a slot carries nothing, dB")
    ] = 75.0
    coherence_time_s: Annotated[float, Meta(ge=1e-9, le=1e3, description="θ, length of a slot, s")] = 5e-5
    latency_threshold_slots: Annotated[
        int, Meta(ge=1, le=1_000_000, description="D_M, slots after which a message is lost")
    ] = 8
    bits_per_float: Annotated[Literal[16, 32, 64], Meta(description="width of a float on the radio")] = 32
    range_m: Annotated[float, Meta(gt=0, description="distance that a broadcast of a UAV reaches, m")] = 100.0
    plausible_speed: Annotated[
        float,
        Meta(
            gt=0,
            description="received states that are faster, or farther away than this speed allows, are not used, m/s",
        ),
    ] = 100.0
    model: Annotated[str, Meta(description="the channel, see `meanflock plugins`")] = "rice"
    options: Annotated[dict[str, Any], Meta(description="options of that channel")] = field(default_factory=dict)

    @property
    def bits_per_slot(self) -> float:
        """θ W_o log₂(1 + η): what a slot carries if its SNR reaches the target."""
        return self.coherence_time_s * self.bandwidth_hz * math.log2(1.0 + 10.0 ** (self.target_snr_db / 10.0))


class VehicleTable(_Table, frozen=True):
    """Vehicle, and constants of the rotary-wing power model, as printed: a craft of a few grams."""

    model: Annotated[str, Meta(description="the vehicle, see `meanflock plugins`")] = "point-mass"
    options: Annotated[dict[str, Any], Meta(description="options of that vehicle")] = field(default_factory=dict)
    acceleration_max: (
        Annotated[
            float,
            Meta(ge=0, description="limit of the acceleration that a UAV can command; unset: no limit, m/s²"),
        ]
        | None
    ) = None
    blade_power: Annotated[float, Meta(ge=0, description="λ0, profile power of the blades, W")] = 0.0049
    induced_power: Annotated[float, Meta(ge=0, description="λ1, induced power in hover, W")] = 0.0887
    power_speed: Annotated[
        Literal["ground", "air"], Meta(description="speed that determines the power: over ground, or through the air")
    ] = "ground"
    parasite_drag: Annotated[float, Meta(ge=0, description="λ2, parasite drag, W s³/m³")] = 0.0092
    tip_speed: Annotated[float, Meta(gt=0, description="ω_tip, speed of the blades' tips, m/s")] = 15.0
    induced_velocity: Annotated[float, Meta(gt=0, description="χ_o, induced velocity in hover, m/s")] = 1.612

    def power(self, squared: Floats, speed: Floats) -> Floats:
        """Blade profile + induced + parasite power in W, Eq. Power1, at speeds in m/s and their squares; same shape."""
        blade = self.blade_power * (1.0 + 3.0 * squared / self.tip_speed**2)
        # √(1+u²) − u = 1/(√(1+u²) + u): the printed form loses all digits at high speed
        induced = squared / (2.0 * self.induced_velocity**2)
        lift = self.induced_power / np.sqrt(np.sqrt(1.0 + induced * induced) + induced)
        return blade + lift + self.parasite_drag * squared * speed / 2.0


class Energy(_Table, frozen=True):
    """Energy of the radio and of the computer; it is in the summary only."""

    radio_W: Annotated[float, Meta(ge=0, description="power of a transmitter, times its time on air, W")] = 0.0
    step_J: Annotated[float, Meta(ge=0, description="energy of one tick of the controller of one UAV, J")] = 0.0


class Metrics(_Table, frozen=True):
    """Radii of the collision metrics."""

    collision_radius: Annotated[float, Meta(gt=0, description="r_coll, distance below which a pair collides, m")] = 0.1
    hazard_radius: Annotated[
        float, Meta(gt=0, description="r_C, distance below which a pair counts for the risk φ_C, m")
    ] = math.sqrt(2.0) / 2.0


class Pace(_Table, frozen=True):
    """Limits of the time that all others wait for one node (wall clock, in lockstep), and of rejoins."""

    slow_s: Annotated[
        float,
        Meta(gt=0, description="a reply is slow if it takes longer than this, and longer than `slow_factor` allows, s"),
    ] = 2.0
    slow_factor: Annotated[
        float, Meta(ge=1, description="a reply is slow if it takes longer than this many times the median of all nodes")
    ] = 10.0
    slow_ticks: Annotated[
        int,
        Meta(ge=1, description="number of slow replies after which a node is lost; one is forgiven every 100 ticks"),
    ] = 50
    wait_share: Annotated[
        float, Meta(gt=0, le=1, description="share of the wall time that all others may wait for one agent alone")
    ] = 0.2
    wait_window_s: Annotated[
        float,
        Meta(
            ge=1,
            le=1e6,
            description="window over which that share is measured; an agent that exceeds it stays out for as long, s",
        ),
    ] = 60.0
    rejoins: Annotated[
        int,
        Meta(
            ge=1, le=1000, description="number of rejoins within `rejoin_ticks` after which a node is refused for good"
        ),
    ] = 5
    rejoin_ticks: Annotated[int, Meta(ge=1, description="window of that limit, ticks")] = 600
