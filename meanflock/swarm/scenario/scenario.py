"""A scenario: its tables, checks of their combinations, quantities derived from them, and its forms (TOML, JSON)."""

import importlib
import os
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self, cast

import msgspec
import numpy as np
from msgspec import field
from numpy.typing import NDArray

from meanflock.swarm import mission, paths, state, toml
from meanflock.swarm.errors import BadInput
from meanflock.swarm.faults import Fault
from meanflock.swarm.scenario import mean_field, tables
from meanflock.swarm.scenario.described import LATER, OURS, PRINTED, key, keys_of
from meanflock.swarm.scenario.until import Until
from meanflock.swarm.scenario.values import as_builtins, toml_text, validated, with_keys
from meanflock.swarm.toml import Table as _Table
from meanflock.swarm.wire.control import FLOAT_OF_BITS

_LEAST_BYTES = 1000  # of a UAV: states, links and commands, without a controller
_POSITION_SCALE_M, _WIDEST_M = 200.0, 250.0  # of the features, and the farthest start that it bears
_LEAST_FROM_STATION_M = 1.0  # between a station and a UAV at its start
_MOST_WITH_DOWNWASH = 2000  # UAVs: their wakes take a fifth of a second and 120 MB in each tick


class _Validating(msgspec.StructMeta):
    """Metaclass that validates the keys of a call of the class. Decoders validate too, and construct without a call."""

    def __call__(cls, **keys: Any) -> "Scenario":
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
        int, key("N, number of UAVs", PRINTED, "S0, the scenario of its first figures", unit="UAVs", ge=1, le=2**31 - 1)
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
            raise BadInput(f"scenario: {source!r}; give the name of a shipped one, a TOML file or a Scenario")
        path = paths.given(source)
        path = path if path.suffix else toml.FOLDER / f"{path}.toml"
        return with_keys(toml.read(path, "scenario"), settings, cls, str(source))

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
        self._check_memory()
        self._check_groups()
        if self.federation.leader >= self.uavs:
            raise ValueError(
                f"`federation.leader` is {self.federation.leader}, but the UAVs are 0…{self.uavs - 1}; name one of them"
            )
        self._check_stations()
        self._check_radios()
        self._check_batteries()
        if self.until is not None:
            Until.of_text(self.until)
        if self.duration < self.dt:
            raise ValueError(f"`duration` {self.duration} s is shorter than one tick, `dt` {self.dt} s")
        for name, drag in (("wind.drag", self.wind.drag), ("truth.drag", self.truth.drag)):
            if drag is not None and self.dt * drag >= 2:
                raise ValueError(f"`dt` {self.dt} s is unstable with `{name}` {drag} 1/s; keep dt·drag < 2")
        longest = self.radio.latency_threshold_slots * self.radio.coherence_time_s
        has_own_bands = self.radio.access == "fdma"  # in one band uploads wait, and the plan says how long
        if has_own_bands and (deadline := self.federation.deadline) is not None and deadline > longest * (1 + 1e-9):
            raise ValueError(
                f"`federation.deadline` {deadline} s is later than an upload can arrive, {longest:g} s: "
                "`radio.latency_threshold_slots` times `radio.coherence_time_s`; take less, or leave it out"
            )
        if self.radio.bands == "cluster" and self.radio.access != "tdma":
            raise ValueError(
                f"`radio.bands` is cluster, but `radio.access` is {self.radio.access}; take tdma, or `radio.bands` one"
            )
        if self.radio.access != "csma" and self.radio.contention_slot_s != tables.Radio().contention_slot_s:
            raise ValueError(
                f"`radio.contention_slot_s` has no effect, because `radio.access` is {self.radio.access}; set "
                "radio.access=csma, or leave it out"
            )
        if self.radio.access == "csma" and self.radio.contention_slots > 0.5 * (1 + 1e-9):
            raise ValueError(
                f"`radio.contention_slot_s` {self.radio.contention_slot_s:g} s is more than half of "
                f"`radio.coherence_time_s` {self.radio.coherence_time_s:g} s; take less, or longer slots"
            )
        self._check_plane()
        if self.wind.downwash != "none" and self.uavs > _MOST_WITH_DOWNWASH:
            raise ValueError(
                f"`wind.downwash` compares all pairs of UAVs, and `uavs` is {self.uavs}; take {_MOST_WITH_DOWNWASH} at "
                "most, or leave it out"
            )
        for number, one in enumerate(self.obstacles):
            if one.height is not None and len(one.centre) > state.PLANE:
                raise ValueError(
                    f"`obstacles[{number}]` is a sphere, because its `centre` has three numbers, and has no `height`; "
                    "leave out the height or the third number"
                )
        mission.check(self)
        widest = float(np.finfo(FLOAT_OF_BITS[self.radio.bits_per_float]).max)
        if mission.has_starts(self) and (farthest := float(np.abs(mission.starts(self)).max())) > widest:
            raise ValueError(
                f"`start` places a UAV {farthest:g} m out, and a float of the radio, `radio.bits_per_float` "
                f"{self.radio.bits_per_float}, holds {widest:g} at most; start nearer, or take a wider float"
            )
        for number, fault in enumerate(self.faults):
            if any(uav >= self.uavs for uav in getattr(fault, "uavs", ())):
                raise ValueError(f"`faults[{number}].uavs` names UAV {max(fault.uavs)} of 0…{self.uavs - 1}")  # type: ignore[union-attr]
            for station in getattr(fault, "stations", ()):
                if station >= len(self.stations):
                    raise ValueError(
                        f"`faults[{number}].stations` names station {station}, and there are {len(self.stations)} "
                        "`[[stations]]`, numbered from 0"
                    )

    def _check_groups(self) -> None:
        """Raises ValueError where `[[groups]]` do not have all UAVs, share a name, or join after the end."""
        if not self.groups:
            if self.federation.group is not None:
                raise ValueError("`federation.group` is set, and there are no `[[groups]]`; add them, or leave it out")
            return
        names = [group.name for group in self.groups]
        if (total := sum(group.count for group in self.groups)) != self.uavs:
            raise ValueError(f"`groups` have {total} UAVs in all, and `uavs` is {self.uavs}; set `uavs` to {total}")
        if twice := [name for name in names if names.count(name) > 1]:
            raise ValueError(f"two `groups` have the name {twice[0]!r}; give each a name of its own")
        for name in self.federation.groups:
            if name not in names:
                raise ValueError(
                    f"`federation.group` names {name!r}, and the groups are {', '.join(names)}; name one of these"
                )
        for number, group in enumerate(self.groups):
            if group.joins_at_s >= self.duration:
                raise ValueError(
                    f"`groups[{number}].joins_at_s` is {group.joins_at_s:g} s, and the flight ends at `duration`, "
                    f"{self.duration:g} s; let it join earlier, or fly longer"
                )
            if group.vehicle is not None and group.vehicle.file is not None:
                raise ValueError(
                    f"`groups[{number}].vehicle` reads its movement from a file, and only the vehicle of all UAVs can; "
                    "set `[vehicle]`, or take another model"
                )
            if group.start is not None and self.dimensions == state.PLANE and group.start.height != self.start.height:
                raise ValueError(
                    f"`groups[{number}].start.height` is {group.start.height:g} m, and in the plane all fly at "
                    f"`start.height`, {self.start.height:g} m; make them equal, or set `space.dimensions` to 3"
                )

    def _check_batteries(self) -> None:
        """Raises ValueError where a reserve cannot carry a UAV from a goal to a landing place, or keys of batteries
        have no effect."""
        energy, default = self.energy, tables.Energy()
        if energy.battery_J is None:
            for name in ("reserve", "landings", "empty"):
                if getattr(energy, name) != getattr(default, name):
                    raise ValueError(f"`energy.{name}` has no effect without `energy.battery_J`; set that too")
            return
        if self.dimensions == state.PLANE and any(len(place) > state.PLANE for place in energy.landings):
            raise ValueError("`energy.landings` has three numbers, and the flight is in the plane; leave the third out")
        if self.vehicle.model != tables.VehicleTable().model or not mission.has_starts(self):
            return  # another vehicle has a power of its own
        speeds = np.linspace(0.5, 50.0, 100)
        least = float((self.vehicle.power(speeds * speeds, speeds) / speeds).min())  # J/m
        farthest = mission.farthest_from_landing(self)
        if (left := energy.reserve * energy.battery_J) < least * farthest:
            raise ValueError(
                f"`energy.battery_J` {energy.battery_J:g} J leaves a reserve of {left:g} J, and {farthest:.4g} m from "
                f"a goal to the nearest landing place take {least * farthest:.4g} J at least; take a larger battery or "
                "reserve, or add a place to `energy.landings`"
            )

    def _check_memory(self) -> None:
        """Raises ValueError where the memory of this machine could not even hold the states of the UAVs.

        What a whole flight needs is checked before it starts.
        """
        least, most = _LEAST_BYTES * self.uavs, os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
        if least > most:
            raise ValueError(
                f"`uavs` is {self.uavs}, which needs {least / 2**30:,.0f} GiB at least, and this machine has "
                f"{most / 2**30:,.0f} GiB; take fewer"
            )

    def _check_plane(self) -> None:
        """Raises ValueError where a flight in the plane has a vector of three numbers, or a key of space."""
        if self.dimensions != state.PLANE:
            return
        of_space = {
            "space.floor": self.space.floor is not None,
            "space.ceiling": self.space.ceiling is not None,
            "wind.profile_exponent": self.wind.profile_exponent > 0.0,
            "wind.downwash": self.wind.downwash != "none",
            **{f"obstacles[{number}].height": one.height is not None for number, one in enumerate(self.obstacles)},
        }
        for name, is_set in of_space.items():
            if is_set:
                raise ValueError(f"`{name}` has no effect in the plane; set `space.dimensions` to 3, or leave it out")
        vectors = {
            "start.positions": self.start.positions,
            "start.centre": (self.start.centre,),
            "destination.positions": self.destination.positions,
            "wind.mean": (self.wind.mean,),
            "truth.wind": (self.truth.wind or (),),
        }
        vectors |= {f"obstacles[{number}].centre": (one.centre,) for number, one in enumerate(self.obstacles)}
        for number, fault in enumerate(self.faults):
            vectors[f"faults[{number}].acceleration"] = (getattr(fault, "acceleration", ()),)
        for name, given in vectors.items():
            if any(len(vector) > state.PLANE for vector in given):
                raise ValueError(
                    f"`{name}` has three numbers, and the flight is in the plane; set `space.dimensions` to 3, or "
                    "leave the third out"
                )

    def _check_stations(self) -> None:
        """Raises ValueError where a station is named that is not there, or stands where a UAV starts."""
        if (station := self.federation.station) is not None and station >= len(self.stations):
            raise ValueError(
                f"`federation.station` is {station}, and there are {len(self.stations)} `[[stations]]`, numbered from "
                f"0; {'name one of them' if self.stations else 'add one'}, or leave the key out"
            )
        if not mission.has_starts(self):
            return
        starts = mission.in_space(self, state.position(mission.starts(self)))
        for number, one in enumerate(self.stations):
            apart = state.length(starts - np.array(one.place))
            if (near := float(apart.min())) < _LEAST_FROM_STATION_M:
                raise ValueError(
                    f"`stations[{number}]` stands {near:.2g} m from the start of UAV {apart.argmin()}, at a height of "
                    f"{starts[apart.argmin(), -1]:g} m; move it {_LEAST_FROM_STATION_M:g} m away or more"
                )

    def _check_radios(self) -> None:
        """Raises ValueError where `[[radios]]` names a UAV twice, or one that is not there."""
        named: set[int] = set()
        for number, radio in enumerate(self.radios):
            if radio.group is not None and radio.group not in (group.name for group in self.groups):
                raise ValueError(f"`radios[{number}].group` names {radio.group!r}, which is none of `groups`; add it")
            for uav in mission.uavs_of(self, radio):
                if uav >= self.uavs:
                    raise ValueError(f"`radios[{number}].uavs` names UAV {uav} of 0…{self.uavs - 1}")
                if uav in named:
                    raise ValueError(
                        f"`radios[{number}].uavs` names UAV {uav}, which has a radio already; name it once"
                    )
                named.add(uav)

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
        group, and the mission of all."""
        own: dict[str, Any] = {}
        if group.method is not None:
            own["method"] = group.method
        if group.controller is not None or group.method not in (None, self.method):
            own["controller"] = group.controller or {}
        if group.training is not None:
            own["training"] = group.training
        if group.vehicle is not None:
            own["vehicle"] = group.vehicle
        if group.destination is not None:
            own["destination"] = msgspec.structs.replace(self.destination, radius=group.destination.radius)
        return msgspec.structs.replace(self, **own)

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
        # The default payloads depend on the radio's floats.
        plain = with_defaults(Scenario(radio=tables.Radio(bits_per_float=self.radio.bits_per_float)))
        whole = self.resolved()
        table, default = msgspec.to_builtins(whole), msgspec.to_builtins(plain)
        table["vehicle"]["options"] = msgspec.to_builtins(whole.vehicle.recorded)
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


def with_defaults(scenario: Scenario) -> Scenario:
    """The same scenario, with the codings of models and the scale of the features written out."""
    payloads = {"payload": scenario.upload_payload, "broadcast_payload": scenario.broadcast_payload}
    return msgspec.structs.replace(
        scenario,
        federation=msgspec.structs.replace(scenario.federation, **payloads),
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
    table.update({name: value for name, value in options.items() if value is not None})
    return validated(table, Scenario, where, single)
