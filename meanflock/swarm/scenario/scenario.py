"""A scenario: its tables, checks of their combinations, quantities derived from them, and its forms (TOML, JSON)."""

import importlib
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self, cast

import msgspec
import numpy as np
from msgspec import field
from numpy.typing import NDArray

from meanflock.swarm import mission, paths, state, toml
from meanflock.swarm.errors import BadInput
from meanflock.swarm.faults import Fault
from meanflock.swarm.scenario import contradictions, mean_field, tables
from meanflock.swarm.scenario.described import LATER, OURS, PRINTED, key, keys_of
from meanflock.swarm.scenario.values import as_builtins, toml_text, validated, with_keys
from meanflock.swarm.toml import Table as _Table

_POSITION_SCALE_M, _WIDEST_M = 200.0, 250.0  # of the features, and the farthest start that it bears


class _Validating(msgspec.StructMeta):
    """Metaclass that validates the keys of a call of the class. Decoders validate too, and construct without a call."""

    def __call__(cls, *given: Any, **keys: Any) -> "Scenario":
        if given:
            raise BadInput(
                f"scenario: {given[0]!r}; give each key by its name: mf.Scenario(uavs=9), or mf.Scenario(**keys)"
            )
        return with_keys({}, keys, cast("type[Scenario]", cls), "scenario")


class Scenario(_Table, frozen=True, kw_only=True, dict=True, metaclass=_Validating):
    """Everything that a run depends on. Immutable. Equal scenarios fly equal trajectories.

    Keys are those of a scenario file. A key that is left out has its default; all defaults together are the paper's
    scenario. A table is a dict or the table of another scenario, and a dotted key sets one key of a table:

        mf.Scenario(uavs=9, method="hjb", wind={"sigma": 0.2, "drag": 0.1})
        mf.Scenario(uavs=9, method="hjb", **{"wind.sigma": 0.2, "wind.drag": 0.1})

    `method` and the options of plug-ins are validated when the scenario is flown: until then a plug-in may be
    registered.

    Raises:
        BadInput: unknown key, wrong type, value out of range, keys that contradict each other, or a key that has
            no effect without another. The message names the key, its value, the bound, and how to fix it.
    """

    method: Annotated[
        str,
        key(
            "name of the controller of the UAVs; see `meanflock plugins`", PRINTED, "the paper's own proposal, MfgFL-HF"
        ),
    ] = "mfgfl-hf"
    controller: Annotated[
        dict[str, Any], key("options of that controller", OURS, "a controller declares its own", later=True)
    ] = field(default_factory=dict)
    uavs: Annotated[
        int,
        key(
            "N, number of UAVs",
            PRINTED,
            "S0, the scenario of its first figures",
            unit="UAVs",
            ge=1,
            le=tables.MOST_UAVS,
        ),
    ] = 25
    seed: Annotated[
        int,
        key("seed of all random numbers", OURS, "any number will do; equal seeds give equal flights", ge=0, le=2**62),
    ] = 1
    dt: Annotated[
        float,
        key(
            "length of a tick",
            PRINTED,
            "Euler–Maruyama: velocity first, then position with the new velocity",
            unit="s",
            ge=1e-06,
            le=1000.0,
        ),
    ] = 0.1
    duration: Annotated[
        float,
        key(
            "simulated time at which the flight ends at the latest",
            OURS,
            "in comparisons a UAV that never arrives counts with this travel time",
            unit="s",
            gt=0,
        ),
    ] = 300.0
    stop: Annotated[
        Literal["arrival", "duration", "rounds"],
        key(
            "the flight ends when all UAVs have arrived, at `duration`, or when the aggregation rule wants no further "
            "round",
            OURS,
            "little of interest follows the last arrival; `duration` continues the flight",
        ),
    ] = "arrival"
    until: (
        Annotated[
            str,
            key(
                "the flight also ends with the round in which the mean over UAVs of a diagnostic, or a metric of the "
                "aggregation rule, reaches a bound, as in accuracy=0.9 (at least) or loss<=0.3; unset: no bound",
                OURS,
                "the paper flies to the destination",
                later=True,
            ),
        ]
        | None
    ) = None
    space: Annotated[tables.Space, LATER] = field(default_factory=tables.Space)
    start: tables.Start = field(default_factory=tables.Start)
    destination: tables.Destination = field(default_factory=tables.Destination)
    obstacles: Annotated[
        tuple[tables.Obstacle, ...],
        key("discs and polygons that no UAV should enter", OURS, "none", later=True, max_length=1000),
    ] = ()
    wind: tables.Wind = field(default_factory=tables.Wind)
    truth: Annotated[tables.Truth, LATER] = field(default_factory=tables.Truth)
    cost: mean_field.Cost = field(default_factory=mean_field.Cost)
    learner: mean_field.LearnerTable = field(default_factory=mean_field.LearnerTable)
    density: mean_field.Density = field(default_factory=mean_field.Density)
    offline: mean_field.OfflineTable = field(default_factory=mean_field.OfflineTable)
    filter: Annotated[tables.FilterTable, LATER] = field(default_factory=tables.FilterTable)
    sharing: Annotated[tables.Sharing, LATER] = field(default_factory=tables.Sharing)
    training: Annotated[tables.Training, LATER] = field(default_factory=tables.Training)
    federation: tables.Federation = field(default_factory=tables.Federation)
    radio: tables.Radio = field(default_factory=tables.Radio)
    stations: Annotated[
        tuple[tables.Station, ...],
        key(
            "nodes of the radio on the ground; they do not fly, learn or count in any metric of the flight",
            OURS,
            "the paper has none",
            later=True,
            max_length=tables.MOST_STATIONS,
        ),
    ] = ()
    groups: Annotated[
        tuple[tables.GroupTable, ...],
        key("groups of UAVs that differ from the others", OURS, "all UAVs are alike", later=True, max_length=100),
    ] = ()
    radios: Annotated[
        tuple[tables.UnequalRadio, ...],
        key("radios of single UAVs, where they differ from `[radio]`", OURS, "all UAVs are alike", later=True),
    ] = ()
    vehicle: tables.VehicleTable = field(default_factory=tables.VehicleTable)
    energy: Annotated[tables.Energy, LATER] = field(default_factory=tables.Energy)
    metrics: tables.Metrics = field(default_factory=tables.Metrics)
    pace: Annotated[tables.Pace, LATER] = field(default_factory=tables.Pace)
    faults: Annotated[tuple[Fault, ...], key("the fault script", OURS, "none", later=True)] = ()

    if TYPE_CHECKING:

        def __init__(self, **keys: Any) -> None: ...

    @classmethod
    def load(cls, source: str | Path, **settings: Any) -> Self:
        """Reads a scenario and sets some of its keys.

        Args:
            source: a TOML file, or the name of a shipped scenario: `"swap"`.
            settings: any dotted key, `**{"wind.sigma": 0.2}`; a whole table as a dict replaces that table.

        Raises:
            BadInput: no such file or scenario, bad TOML, or an invalid scenario.
        """
        if not isinstance(source, str | Path):
            raise BadInput(
                f"scenario: {source!r}; give the name of a shipped one, a TOML file or a Scenario; of keys "
                "mf.Scenario(**keys) makes one"
            )
        return with_keys(toml.read(paths.given(source), "scenario"), settings, cls, str(source))

    def replace(self, **settings: Any) -> Self:
        """A copy with some keys set; this scenario stays as it is.

        Args:
            settings: any dotted key, `**{"wind.sigma": 0.2}`; a whole table as a dict replaces that table.

        Raises:
            BadInput: the copy is an invalid scenario.
        """
        return with_keys(as_builtins(self), settings, type(self), "scenario")

    def save(self, path: str | Path) -> Path:
        """Writes every key that is set to a TOML file, from which `load` returns an equal scenario.

        Returns:
            The path of the file.

        Raises:
            BadInput: no file can be made there, or an option of a plug-in is None, which TOML cannot express.
            RunFailed: the disk is full.
        """
        from meanflock.swarm import durable  # only here: nodes write no files

        text = toml_text(self).encode()
        path = paths.given(path)
        with durable.replacing(path) as file:
            durable.write(file, text)
        return path

    def __post_init__(self) -> None:
        super().__post_init__()
        contradictions.check(self)

    @property
    def dimensions(self) -> int:
        """Number of axes of the flight, d: the numbers of a position, a velocity or an acceleration."""
        return self.space.dimensions

    @property
    def state_numbers(self) -> int:
        """Numbers of a state, 2d: of position and velocity."""
        return 2 * self.dimensions

    @property
    def nodes(self) -> int:
        """Number of nodes of the radio, N + B: the UAVs, then the stations, which are nodes N, N + 1, …"""
        return self.uavs + len(self.stations)

    @property
    def period_ticks(self) -> int:
        """Ticks between rounds, n0: by the scenario, else by the controller, which is then made.

        Raises:
            BadInput: the controller is asked for, and the scenario cannot be flown here.
        """
        return self.federation.period or int(_plan_of(self).period_ticks)

    @property
    def members(self) -> NDArray[np.intp]:
        """The UAVs that take part in rounds, ascending: of the groups of `federation.group`, else all."""
        taking_part = np.ones(self.uavs, dtype=bool)
        if self.federation.groups:
            for group, rows in mission.parts(self):
                taking_part[rows] = group.name in self.federation.groups
        return np.flatnonzero(taking_part)

    @property
    def participants(self) -> int:
        """Number of UAVs that upload in a round, N_h, at least one."""
        return max(1, round(self.federation.fraction * len(self.members)))

    def of_group(self, group: tables.GroupTable) -> "Scenario":
        """The scenario as the controller of a group gets it: method, learner, vehicle and radius of arrival of the
        group, and the mission, the methods, their options and the vehicles of all."""
        named = tuple(
            msgspec.structs.replace(
                other,
                method=other.method or self.method,
                controller=self._options_of(other),
                vehicle=other.vehicle if group.vehicle is None else other.vehicle or self.vehicle,
            )
            for other in self.groups
        )
        own: dict[str, Any] = {"groups": named, "controller": self._options_of(group)}
        if group.method is not None:
            own["method"] = group.method
        if group.training is not None:
            own["training"] = group.training
        if group.vehicle is not None:
            own["vehicle"] = group.vehicle
        if group.destination is not None:
            own["destination"] = msgspec.structs.replace(self.destination, radius=group.destination.radius)
        return msgspec.structs.replace(self, **own)

    def _options_of(self, group: tables.GroupTable) -> dict[str, Any]:
        """The options of a group's controller."""
        if group.controller is not None:
            return group.controller
        return self.controller if group.method in (None, self.method) else {}

    def alone(self, group: tables.GroupTable) -> "Scenario":
        """The scenario that the vehicle of a group gets if it reads a file. Its UAVs are 0…count − 1, and no others."""
        start = tables.Start(centre=self.start.centre, height=self.start.height) if group.start is None else group.start
        return msgspec.structs.replace(
            self,
            uavs=group.count,
            groups=(),
            start=start,
            destination=tables.Destination(),
            vehicle=group.vehicle or self.vehicle,
            federation=tables.Federation(),
            stations=(),
            radios=(),
            faults=(),
        )

    def every_group_has(self, key: str) -> bool:
        """Returns whether there are groups, and each sets a key, such as "method", in place of the flight's."""
        return len(self.groups) > 0 and all(getattr(group, key) is not None for group in self.groups)

    @property
    def upload_payload(self) -> str:
        """Coding of uploads."""
        return self.federation.payload or self.radio_payload

    @property
    def broadcast_payload(self) -> str:
        """Coding of the global model."""
        return self.federation.broadcast_payload or self.radio_payload

    @property
    def radio_payload(self) -> str:
        """Coding of the radio's floats."""
        return f"float{self.radio.bits_per_float}"

    @property
    def position_scale_m(self) -> float:
        """Scale of positions in the features of the mean-field methods, L_r, m."""
        if self.learner.position_scale is not None:
            return self.learner.position_scale
        farthest = float(np.abs(state.position(mission.starts(self)) - mission.goals(self)).max())
        return _POSITION_SCALE_M if farthest <= _WIDEST_M else farthest

    @property
    def max_ticks(self) -> int:
        """Number of ticks until `duration`."""
        return max(1, round(self.duration / self.dt))

    def delivery_ticks(self, slots: NDArray[np.int64]) -> NDArray[np.intp]:
        """Ticks until a message that took so many slots is delivered: max(1, ⌈slots θ/dt⌉), same shape.

        A quotient within 1e-9 of a whole number counts as that number.
        """
        ticks = slots * self.radio.coherence_time_s / self.dt
        return np.maximum(1, np.ceil(ticks * (1.0 - 1e-9))).astype(np.intp)

    @property
    def hop_ticks(self) -> int:
        """Ticks after which a message that does not wait for the band has arrived or is lost."""
        return int(self.delivery_ticks(np.array(self.radio.latency_threshold_slots)))

    @property
    def deadline_ticks(self) -> int:
        """Ticks after which the uploads of a round are averaged."""
        if self.federation.deadline is None:
            return self.hop_ticks
        return int(self.delivery_ticks(np.array(self.federation.deadline / self.radio.coherence_time_s)))

    def known(self) -> "Scenario":
        """The scenario that agents and leader get: without `[truth]`, and of `[energy]` with the battery alone. No
        controller may use the rest."""
        battery = msgspec.structs.replace(self.energy, radio_W=0.0, receive_W=0.0, idle_W=0.0, step_J=0.0)
        if self.truth == tables.Truth() and self.energy == battery:
            return self
        return msgspec.structs.replace(self, truth=tables.Truth(), energy=battery)

    @property
    def is_guided(self) -> bool:
        """Returns whether goals may change in flight: there are waypoints or batteries."""
        return self.energy.battery_J is not None or self.has_waypoints

    @property
    def has_waypoints(self) -> bool:
        """Returns whether any UAV has waypoints."""
        return any(len(table.waypoints) > 0 for _, table in mission.destinations(self))

    def flown(self) -> "Scenario":
        """The scenario of the world's vehicles, with drag and wind of `[truth]`."""
        true, wind = self.truth, self.wind
        drag = wind.drag if true.drag is None else true.drag
        mean = wind.mean if true.wind is None else true.wind
        return msgspec.structs.replace(self, wind=msgspec.structs.replace(wind, drag=drag, mean=mean))

    def resolved(self) -> "Scenario":
        """The same scenario, with the defaults that depend on plug-ins filled in; these are then made.

        Raises:
            BadInput: it cannot be flown here, and was not resolved where it was flown.
        """
        try:
            whole: Scenario = _plan_of(self).scenario
        except BadInput:
            if self.federation.period is None:
                raise
            whole = with_defaults(self)  # of a run whose plug-in or file is not here
        return whole

    def sha256(self) -> str:
        """Hash of the resolved scenario; it does not depend on the form in which the scenario was written."""
        whole = self.resolved()
        table, default = msgspec.to_builtins(whole), _default_table(self.radio.bits_per_float)
        table["vehicle"]["options"] = msgspec.to_builtins(whole.vehicle.recorded)
        for plain_group, group in zip(table.get("groups", ()), whole.groups, strict=False):
            if group.vehicle is not None:
                plain_group["vehicle"]["options"] = msgspec.to_builtins(group.vehicle.recorded)
        for path, described in keys_of(Scenario).items():
            if not described.later:
                continue
            *parents, key = path.split(".")
            part, standard = table, default
            for parent in parents:
                part, standard = part.get(parent, {}), standard[parent]
            if key in part and part[key] == standard[key]:
                del part[key]
        import hashlib  # only here: it loads OpenSSL, which agents do not need

        return hashlib.sha256(msgspec.json.encode(table, order="sorted")).hexdigest()


@cache
def _default_table(bits_per_float: Literal[16, 32, 64]) -> dict[str, Any]:
    """The table of the scenario without any key but the floats of the radio, on which the default payloads depend."""
    table: dict[str, Any] = msgspec.to_builtins(
        with_defaults(Scenario(radio=tables.Radio(bits_per_float=bits_per_float)))
    )
    return table


def with_defaults(scenario: Scenario, **federation: Any) -> Scenario:
    """The same scenario, with the codings of models and the scale of the features written out.

    Args:
        federation: other keys of `[federation]`, and their values.
    """
    federation |= {"payload": scenario.upload_payload, "broadcast_payload": scenario.broadcast_payload}
    return msgspec.structs.replace(
        scenario,
        federation=msgspec.structs.replace(scenario.federation, **federation),
        learner=msgspec.structs.replace(scenario.learner, position_scale=scenario.position_scale_m),
    )


def _plan_of(scenario: Scenario) -> Any:
    """The plan of a scenario. Its module is loaded by name, as a plug-in is: only a scenario that is flown needs it."""
    return importlib.import_module("meanflock.federation.plan").plan_of(scenario)


class _FaultFile(_Table, frozen=True):
    """A file with faults only."""

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
    """The `[[faults]]` of a TOML file that has nothing else, for `load(..., faults=...)`.

    Raises:
        BadInput: unreadable file, or not a fault script; the message names the file, the fault and the key.
    """
    table = toml.read(path, "fault script")
    if set(table) != {"faults"}:
        raise BadInput(f"{path}: a fault script has [[faults]] and nothing else, see scenarios/faults.toml")
    validated(table, _FaultFile, str(path))
    faults: list[dict[str, Any]] = table["faults"]
    return faults


def schema() -> dict[str, Any]:
    """JSON schema of a scenario file, with units and bounds."""
    return msgspec.json.schema(Scenario)


def load(path: Path | None, settings: Iterable[str] = (), **options: Any) -> Scenario:
    """Reads a TOML file (None: the paper's scenario), then applies `a.b=c` settings, then named options.

    Raises:
        BadInput: unreadable file, bad TOML, unknown key, wrong type or value out of range, or a key that has no
            effect without another; the message names the file or setting, the key and the bound.
    """
    table: dict[str, Any] = {}
    where = "scenario"
    if path is not None:
        where = str(path)
        table = toml.read(path, "scenario file")
    single = [toml.apply(table, setting) for setting in settings]
    given = {name: value for name, value in options.items() if value is not None}
    return validated(table | given, Scenario, where, [*single, *given])
