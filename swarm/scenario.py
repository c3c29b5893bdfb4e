"""A scenario: every number a run depends on, with its unit, its bounds and the paper's value as default."""

import math
from collections.abc import Iterable
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias, cast

import msgspec
from msgspec import Meta, field

from meanflock.swarm import clusters, toml
from meanflock.swarm.declared import Declared, declared
from meanflock.swarm.errors import BadInput
from meanflock.swarm.faults import Fault, LeaderLoss
from meanflock.swarm.pace import Pace
from meanflock.swarm.plugins import Door, find
from meanflock.swarm.table import Table as _Table

# Keys that came later count in the hash only where they differ from their default: older runs keep their hash.
_LATER = (
    "faults",
    "federation.aggregation",
    "federation.tolerance",
    "federation.byzantine_fraction",
    "federation.byzantine_kind",
    "federation.payload",
    "federation.broadcast_payload",
    "federation.error_feedback",
    "federation.clusters",
    "federation.options",
    "controller",
    "radio.plausible_speed",
    *("radio.model", "radio.options", "vehicle.model", "vehicle.options"),
    "pace",
)

Payload: TypeAlias = Literal["float64", "float32", "float16", "int8"]  # how a model is written, see swarm/payload.py
_PAYLOAD_BITS: dict[Payload, int] = {"float64": 64, "float32": 32, "float16": 16, "int8": 8}  # a weight


class Start(_Table, frozen=True):
    """Where the swarm takes off: a square grid at rest."""

    centre: Annotated[tuple[float, float], Meta(description="centre of the grid, m")] = (150.0, 100.0)
    spacing: Annotated[float, Meta(gt=0, description="distance of neighbours, m")] = math.sqrt(2.0)
    height: Annotated[float, Meta(gt=0, description="constant altitude h, m")] = 40.0


class Destination(_Table, frozen=True):
    """Where it goes: the origin."""

    radius: Annotated[float, Meta(gt=0, description="s_dest: arrived when ‖s‖ ≤ this, m and m/s")] = 5.0


class Wind(_Table, frozen=True):
    """The Ornstein–Uhlenbeck wind."""

    sigma: Annotated[float, Meta(ge=0, description="σ_wind, diffusion of velocity, m/s/√s")] = 0.1
    mean: Annotated[tuple[float, float], Meta(description="v_o, mean wind, m/s")] = (1.0, -1.0)
    drag: Annotated[float, Meta(ge=0, description="c0, drag towards the mean wind, 1/s")] = 0.1


class Cost(_Table, frozen=True):
    """The running cost φ_L + c2 φ_G + c3 ‖a‖²."""

    c1: Annotated[float, Meta(ge=0, description="weight of ‖v‖², s²/m²")] = 0.015
    c2: Annotated[float, Meta(ge=0, description="weight of φ_G")] = 0.015
    c3: Annotated[float, Meta(gt=0, description="weight of ‖a‖², s⁴/m²")] = 0.005
    epsilon: Annotated[float, Meta(gt=0, description="ε of the interaction kernel, m²")] = 1.0
    beta: Annotated[float, Meta(ge=0, description="β, exponent of the interaction kernel")] = 1.0


class Learner(_Table, frozen=True):
    """The two networks."""

    mu_h: Annotated[float, Meta(gt=0, description="μ_H, step size of the value learner")] = 0.01
    mu_f: Annotated[float, Meta(gt=0, description="μ_F, step size of the density learner")] = 0.01
    c_h: Annotated[float, Meta(ge=0, description="c_H, weight of the regulariser")] = 0.5
    kappa: Annotated[float, Meta(gt=-1, lt=1, description="κ, position–velocity term of L_s, 1/s")] = 0.01
    position_scale: Annotated[float, Meta(gt=0, description="L_r, features see x / L_r, m")] = 200.0
    velocity_scale: Annotated[float, Meta(gt=0, description="L_v, features see v / L_v, m/s")] = 20.0


class Density(_Table, frozen=True):
    """The fit of m̂ at t = 0 and the quadrature of φ_G."""

    position_bandwidth: Annotated[float, Meta(gt=0, description="std of a mixture component, m")] = 3.0
    velocity_bandwidth: Annotated[float, Meta(gt=0, description="std of a mixture component, m/s")] = 0.7
    near_samples: Annotated[int, Meta(ge=1, le=100_000, description="fit samples near the swarm")] = 1000
    box_samples: Annotated[int, Meta(ge=1, le=100_000, description="fit samples in the whole box ±L")] = 1000
    ridge: Annotated[float, Meta(gt=0, description="ridge of the fit, relative to the sample count")] = 1e-6
    node_position_std: Annotated[float, Meta(gt=0, description="spread of quadrature nodes, m")] = 5.0
    node_velocity_std: Annotated[float, Meta(gt=0, description="spread of quadrature nodes, m/s")] = 1.5


class Offline(_Table, frozen=True):
    """What the open-loop plan of the offline method may ask of the craft, over ground."""

    speed_max: Annotated[float, Meta(ge=0.1, description="limit on ‖v‖, m/s")] = 15.0
    acceleration_max: Annotated[float, Meta(ge=0.01, description="limit on ‖dv/dt‖, m/s²")] = 3.0


class Federation(_Table, frozen=True):
    """The rounds."""

    period: (
        Annotated[int, Meta(ge=1, description="n0, ticks between rounds; unset: as the controller declares")] | None
    ) = None
    fraction: Annotated[float, Meta(gt=0, le=1, description="N_h / N, share of UAVs that upload")] = 0.8
    leader: Annotated[int, Meta(ge=0, description="h, the UAV that averages")] = 0
    state_period: Annotated[int, Meta(ge=0, description="n_s, ticks between state shares of mfg; 0: once")] = 0
    aggregation: Annotated[
        str, Meta(description="how the leader makes one model of many; `meanflock plugins` lists the rules")
    ] = "fedavg"
    options: Annotated[dict[str, Any], Meta(description="options of that rule")] = msgspec.field(default_factory=dict)
    tolerance: Annotated[
        float, Meta(ge=0, lt=0.5, description="share of uploads trimmed-mean and krum assume to be false")
    ] = 0.25
    byzantine_fraction: Annotated[float, Meta(ge=0, le=1, description="share of UAVs whose uploads are false")] = 0.0
    byzantine_kind: Annotated[
        Literal["huge", "sign-flip", "boost", "noise"],
        Meta(description="what a false upload is"),
    ] = "sign-flip"
    payload: Annotated[Payload, Meta(description="how uploads are written; unset: as the radio's floats")] | None = None
    broadcast_payload: (
        Annotated[Payload, Meta(description="how the global model is written; unset: as the radio's floats")] | None
    ) = None
    error_feedback: Annotated[
        bool, Meta(description="what rounding to a narrower payload takes from an upload is added to the UAV's next")
    ] = True
    clusters: Annotated[int, Meta(ge=1, description="K, clusters whose heads average for the leader; 1: none do")] = 1


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
    range_m: Annotated[float, Meta(gt=0, description="how far a broadcast of a UAV reaches, m")] = 100.0
    plausible_speed: Annotated[
        float, Meta(gt=0, description="a received state that is faster, or too far away for it, is not believed, m/s")
    ] = 100.0
    model: Annotated[str, Meta(description="the channel, see `meanflock plugins`")] = "rice"
    options: Annotated[dict[str, Any], Meta(description="what the channel takes besides these keys")] = msgspec.field(
        default_factory=dict
    )


class Vehicle(_Table, frozen=True):
    """Which vehicle flies, and the constants of the rotary-wing power model, as printed: a craft of a few grams."""

    model: Annotated[str, Meta(description="the vehicle, see `meanflock plugins`")] = "point-mass"
    options: Annotated[dict[str, Any], Meta(description="what the vehicle takes besides these keys")] = msgspec.field(
        default_factory=dict
    )
    blade_power: Annotated[float, Meta(ge=0, description="λ0, profile power of the blades, W")] = 0.0049
    induced_power: Annotated[float, Meta(ge=0, description="λ1, induced power in hover, W")] = 0.0887
    parasite_drag: Annotated[float, Meta(ge=0, description="λ2, parasite drag, W s³/m³")] = 0.0092
    tip_speed: Annotated[float, Meta(gt=0, description="ω_tip, speed of the blades' tips, m/s")] = 15.0
    induced_velocity: Annotated[float, Meta(gt=0, description="χ_o, induced velocity in hover, m/s")] = 1.612


class Metrics(_Table, frozen=True):
    """Radii of the collision metrics."""

    collision_radius: Annotated[float, Meta(gt=0, description="r_coll, nearer than this is a collision, m")] = 0.1
    hazard_radius: Annotated[float, Meta(gt=0, description="r_C, nearer than this is a risk, m")] = math.sqrt(2.0) / 2.0


class Scenario(_Table, frozen=True, dict=True):
    """Everything a run depends on. Immutable; equal scenarios and seeds fly equal trajectories."""

    method: Annotated[str, Meta(description="the controller of the UAVs; `meanflock plugins` lists them")] = "mfgfl-hf"
    controller: Annotated[dict[str, Any], Meta(description="options of that controller")] = msgspec.field(
        default_factory=dict
    )
    uavs: Annotated[int, Meta(ge=1, le=100_000, description="N, how many UAVs fly")] = 25
    seed: Annotated[int, Meta(ge=0, le=2**62, description="source of all randomness")] = 1
    dt: Annotated[float, Meta(ge=1e-6, le=1e3, description="a tick, s")] = 0.1
    duration: Annotated[float, Meta(gt=0, description="the run ends at the latest now, s")] = 300.0
    stop: Annotated[Literal["arrival", "duration"], Meta(description="end when all have arrived, or at `duration`")] = (
        "arrival"
    )
    start: Start = field(default_factory=Start)
    destination: Destination = field(default_factory=Destination)
    wind: Wind = field(default_factory=Wind)
    cost: Cost = field(default_factory=Cost)
    learner: Learner = field(default_factory=Learner)
    density: Density = field(default_factory=Density)
    offline: Offline = field(default_factory=Offline)
    federation: Federation = field(default_factory=Federation)
    radio: Radio = field(default_factory=Radio)
    vehicle: Vehicle = field(default_factory=Vehicle)
    metrics: Metrics = field(default_factory=Metrics)
    pace: Pace = field(default_factory=Pace)
    faults: Annotated[tuple[Fault, ...], Meta(description="the fault script")] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.federation.leader >= self.uavs:
            raise ValueError(
                f"`federation.leader` is {self.federation.leader}, but the UAVs are 0…{self.uavs - 1}; name one of them"
            )
        if self.duration < self.dt:
            raise ValueError(f"`duration` {self.duration} s is shorter than one tick, `dt` {self.dt} s")
        if self.dt * self.wind.drag >= 2:
            raise ValueError(f"`dt` {self.dt} s is unstable with `wind.drag` {self.wind.drag} 1/s; keep dt·drag < 2")
        for key in ("payload", "broadcast_payload"):
            wanted, radio_bits = getattr(self.federation, key), self.radio.bits_per_float
            if wanted is not None and _PAYLOAD_BITS[wanted] > radio_bits:
                raise ValueError(
                    f"`federation.{key}` {wanted} is wider than a float of the radio, `radio.bits_per_float` "
                    f"{radio_bits}; take a narrower payload or a wider float"
                )
        clusters.check(self)
        for number, fault in enumerate(self.faults):
            if any(uav >= self.uavs for uav in getattr(fault, "uavs", ())):
                raise ValueError(f"`faults[{number}].uavs` names UAV {max(fault.uavs)} of 0…{self.uavs - 1}")  # type: ignore[union-attr]

    @cached_property
    def declared(self) -> Declared:
        """What its controller declares.

        Raises:
            BadInput: the controller is not installed here, or its options do not fit.
        """
        return declared(self)

    @property
    def period_ticks(self) -> int:
        """n0: the scenario's, or the controller's own."""
        return self.federation.period or self.declared.period_ticks

    @property
    def participants(self) -> int:
        """N_h, at least one."""
        return max(1, round(self.federation.fraction * self.uavs))

    @property
    def upload_payload(self) -> Payload:
        """How uploads are written."""
        return self.federation.payload or self._radio_payload

    @property
    def broadcast_payload(self) -> Payload:
        """How the global model is written."""
        return self.federation.broadcast_payload or self._radio_payload

    @property
    def keeps_residuals(self) -> bool:
        """Whether every UAV keeps what rounding took from its last upload: where that is narrower than a float."""
        narrower = _PAYLOAD_BITS[self.upload_payload] < self.radio.bits_per_float
        return self.declared.is_federated and self.federation.error_feedback and narrower

    @property
    def _radio_payload(self) -> Payload:
        return cast(Payload, f"float{self.radio.bits_per_float}")

    @property
    def max_ticks(self) -> int:
        """Ticks until `duration`."""
        return max(1, round(self.duration / self.dt))

    def plugins(self) -> tuple[tuple[Door, str, str], ...]:
        """Door, name and fingerprint of every plug-in it needs.

        Raises:
            BadInput: one is not installed here.
        """
        wanted: tuple[tuple[Door, str], ...] = (
            ("controller", self.method),
            ("aggregator", self.federation.aggregation),
            ("channel", self.radio.model),
            ("vehicle", self.vehicle.model),
        )
        return tuple((door, name, find(door, name).fingerprint) for door, name in wanted)

    def leaders(self, tick: int = 0) -> int:
        """Leader nodes that should be there in a tick: one, and a standby for every loss the fault script has one
        for, without those lost before; 0 or 1 where there are no rounds."""
        losses = [fault for fault in self.faults if isinstance(fault, LeaderLoss)]
        started = 1 + sum(fault.standby for fault in losses)
        left = max(0, started - sum(fault.begins(self.dt) < tick for fault in losses))
        return left if self.declared.is_federated else min(left, 1)

    def resolved(self) -> "Scenario":
        """The same scenario with what depends on the method written out."""
        federation = msgspec.structs.replace(
            self.federation,
            period=self.period_ticks,
            payload=self.upload_payload,
            broadcast_payload=self.broadcast_payload,
        )
        return msgspec.structs.replace(self, federation=federation)

    def sha256(self) -> str:
        """Hash of the resolved scenario; equal scenarios have equal hashes however they were written."""
        plain = Scenario(radio=Radio(bits_per_float=self.radio.bits_per_float))  # payloads go by it
        table, default = (msgspec.to_builtins(one.resolved()) for one in (self, plain))
        for path in _LATER:
            *parents, key = path.split(".")
            part, standard = table, default
            for parent in parents:
                part, standard = part[parent], standard[parent]
            if part[key] == standard[key]:
                del part[key]
        import hashlib  # only here: it loads OpenSSL, and an agent never asks

        return hashlib.sha256(msgspec.json.encode(table, order="sorted")).hexdigest()


class _Script(_Table, frozen=True):
    """A file of faults alone."""

    faults: tuple[Fault, ...]


def encode(scenario: Scenario) -> bytes:
    """Canonical JSON, keys sorted."""
    return msgspec.json.encode(scenario, order="sorted")


def decode(raw: bytes) -> Scenario:
    """A scenario from JSON.

    Raises:
        BadInput: not a valid scenario.
    """
    try:
        return msgspec.json.decode(raw, type=Scenario)
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise BadInput(f"scenario: {error}") from error


def read_faults(path: Path) -> list[dict[str, Any]]:
    """The `[[faults]]` of a TOML file that holds nothing else, as `load(..., faults=...)` takes them.

    Raises:
        BadInput: unreadable file, or not a fault script; the message names the file, the fault and the key.
    """
    table = toml.read(path, "fault script")
    if set(table) != {"faults"}:
        raise BadInput(f"{path}: a fault script holds [[faults]] and nothing else, see scenarios/faults.toml")
    try:
        msgspec.convert(table, _Script)
    except msgspec.ValidationError as error:
        raise BadInput(f"{path}: {_explain(error, _Script)}") from error
    faults: list[dict[str, Any]] = table["faults"]
    return faults


def schema() -> dict[str, Any]:
    """JSON schema of a scenario file, with units and bounds."""
    return msgspec.json.schema(Scenario)


def load(path: Path | None, settings: Iterable[str] = (), **options: Any) -> Scenario:
    """Reads a TOML file (none: the paper's scenario), then applies `a.b=c` settings, then named options.

    Raises:
        BadInput: unreadable file, bad TOML, unknown key, wrong type or value out of range; the message names
            the file or setting, the key and the bound.
    """
    table: dict[str, Any] = msgspec.field(default_factory=dict)
    where = "scenario"
    if path is not None:
        where = str(path)
        table = toml.read(path, "scenario file")
    for setting in settings:
        toml.apply(table, setting)
    table.update({name: value for name, value in options.items() if value is not None})
    return from_table(table, where)


def from_table(table: dict[str, Any], where: str) -> Scenario:
    """The scenario a table of plain values says; `where` it comes from.

    Raises:
        BadInput: unknown key, wrong type or value out of range.
    """
    try:
        return msgspec.convert(table, Scenario)
    except msgspec.ValidationError as error:
        raise BadInput(f"{where}: {_explain(error, Scenario)}") from error


def to_table(scenario: Scenario) -> dict[str, Any]:
    """A scenario as plain values, as `from_table` takes them."""
    table: dict[str, Any] = msgspec.to_builtins(scenario)
    return table


def _explain(error: msgspec.ValidationError, kind: type) -> str:
    from meanflock.swarm.explain import explain  # only here: nodes are sent scenarios that are sound

    return explain(str(error), kind)
