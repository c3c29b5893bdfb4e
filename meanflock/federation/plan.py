"""Plan: a scenario with its plug-ins made and their declarations read. What contradicts is refused here.

A scenario is data and loads no plug-in. Whatever flies needs its plan, which is made once.
"""

import functools
import math
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.federation.band import duties
from meanflock.federation.cut import WHOLE, coding_of
from meanflock.federation.groups import Group, grouped
from meanflock.federation.seat import name_of, seat
from meanflock.federation.topology.base import Hop, linked
from meanflock.swarm import mission, plugins
from meanflock.swarm.counts import count_of
from meanflock.swarm.declared import NO_FILTER, NO_LEARNER, Declared, column_names
from meanflock.swarm.errors import FAILURES, BadInput, last_line
from meanflock.swarm.faults import Interference, LeaderLoss
from meanflock.swarm.global_generators import DrawWatch
from meanflock.swarm.plugins import PluginKind
from meanflock.swarm.scenario import Scenario, Sharing, Until, as_builtins

_NO_PLUGIN = (("learner", NO_LEARNER), ("filter", NO_FILTER))
_PLAN = "plan"  # attribute of a scenario that keeps its plan
LEADER, CLUSTERS = "leader", "clusters"  # topologies of a scenario that names none: of one cluster, and of more


class Plan:
    """All that is known of a flight before it begins.

    Attributes:
        given: the scenario as it was given, with the starts of the UAVs if its vehicle reads them from a file.
        scenario: the same, resolved: keys that were left out and depend on a plug-in have its values.
        groups: the UAVs by controller, in the order of their first UAVs.
        declared: the declarations of all groups in one: of the model and the rounds, those of the groups that take
            part; the diagnostics of all; else the largest.
        hops: the hops of every round; none for methods without rounds.
        topology_draws: whether the topology drew from a global random generator to make them.
    """

    def __init__(self, scenario: Scenario, declared: Declared | None = None) -> None:
        """
        Args:
            scenario: what is flown.
            declared: the declarations of its controller, where that is not found by its name; None: find it.

        Raises:
            BadInput: a plug-in is not installed here, its options do not fit, or keys and plug-ins contradict
                each other.
        """
        asked, scenario = scenario, _with_starts(scenario)
        self.given = scenario
        self.scenario, self.declared, self.groups = grouped(scenario, declared)
        if scenario.sharing != Sharing() and not self.declared.shares:
            raise BadInput(
                f"`[sharing]` is set, but controller {self.method!r} shares no states; remove that table, or set a "
                "filter, which shares them: filter.kind=ecbf"
            )
        self._check_guided()
        self._check_codings()
        self._check_rule()
        self._check_resumable()
        self._check_until()
        self._check_silence()
        self._check_radio()
        draws = None if plugins.is_own(plugins.find("topology", topology_of(self.scenario))) else DrawWatch()
        self.hops = self._hops()
        self.topology_draws = draws is not None and draws.finds_a_draw_now()
        self._check_duty()
        self._check_bands()
        for one in (asked, scenario, self.scenario):
            vars(one)[_PLAN] = self

    @property
    def method(self) -> str:
        """Names of the controllers, joined by "+"."""
        return mission.method(self.scenario)

    @functools.cached_property
    def foreign_plugins(self) -> tuple[str, ...]:
        """The plug-ins of the flight that are not meanflock's own, as `controller 'spring'`."""
        found = (plugins.find(kind, name) for kind, name, _ in plugins_of(self.scenario))
        return tuple(f"{one.kind} {one.name!r}" for one in found if not plugins.is_own(one))

    @functools.cached_property
    def has_column(self) -> NDArray[np.bool_] | None:
        """Mask (N, C) of the `columns` that each UAV has; those that it has not are 0. None: every UAV has all."""
        names = self.columns
        has = np.zeros((self.scenario.uavs, len(names)), dtype=bool)
        for group in self.groups:
            own = {*group.declared.diagnostics, *_shown_by(group.scenario.vehicle.model)}
            has[group.uavs] = [name in own for name in names]
        return None if has.all() else has

    @property
    def has_diagnostic(self) -> NDArray[np.bool_] | None:
        """The same of the diagnostics, (N, K)."""
        has = None if self.has_column is None else self.has_column[:, : len(self.declared.diagnostics)]
        return None if has is None or has.all() else has

    def node_firsts(self, rows: int) -> list[int]:
        """The first UAV of each node, ascending, if a node has up to so many UAVs, all of one group."""
        return sorted(uav for group in self.groups for uav in group.uavs[::rows].tolist())

    def places(self, group: Group) -> list[int]:
        """The columns of the diagnostics of a group among those of all."""
        return [self.declared.diagnostics.index(name) for name in group.declared.diagnostics]

    @functools.cached_property
    def shown(self) -> tuple[str, ...]:
        """Names of the numbers that the vehicle shows of every UAV.

        Raises:
            BadInput: they cannot be names of columns.
        """
        found: dict[str, None] = {}
        for model in dict.fromkeys(group.scenario.vehicle.model for group in self.groups):
            shown = _shown_by(model)
            if shared := sorted({*shown} & {*self.declared.diagnostics}):
                raise BadInput(
                    f"vehicle {model!r}: `columns` {', '.join(shared)}: controller {self.method!r} has diagnostics of "
                    "that name; give it another"
                )
            found |= dict.fromkeys(shown)
        return tuple(found)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the numbers of every UAV and tick: diagnostics of the controller, then what the vehicle shows."""
        return (*self.declared.diagnostics, *self.shown)

    @property
    def period_ticks(self) -> int:
        """Ticks between rounds, n0."""
        return self.scenario.period_ticks

    def seat(self, number: int) -> int:
        """The node where the leader averages a round: a UAV, or a station."""
        return seat(self.scenario, number * self.period_ticks)

    def senders(self, hop: Hop, number: int) -> NDArray[np.intp]:
        """The nodes (S,) that may transmit in a hop of a round: its senders, or the one where the leader averages."""
        if hop.role == "agent" or self.scenario.federation.station is None:
            return hop.senders
        return np.array([self.seat(number)])

    @property
    def keeps_residuals(self) -> bool:
        """Returns whether UAVs store rounding errors of uploads, which are then narrower than the radio's floats."""
        if not (self.declared.is_federated and self.scenario.federation.error_feedback):
            return False
        return coding_of(self.scenario, self.scenario.upload_payload).bits < self.scenario.radio.bits_per_float

    @property
    def node_scenario(self) -> Scenario:
        """The scenario that agents and leader get: without what no controller may know, and with the size of fragments
        written out and no limit of duty, so that they need no channel."""
        cuts = [hop.codec.cut for hop in self.hops]
        slots = max((cut.slots for cut in cuts if cut is not None), default=WHOLE)
        told = self.scenario.known()
        federation = msgspec.structs.replace(told.federation, fragment=slots)
        return msgspec.structs.replace(
            told, federation=federation, radio=msgspec.structs.replace(told.radio, duty_max=None)
        )

    def leaders(self, tick: int = 0) -> int:
        """Number of leader nodes in a tick: one, plus a standby for each loss with `standby`, minus the losses before.

        0 or 1 without rounds.
        """
        losses = [fault for fault in self.scenario.faults if isinstance(fault, LeaderLoss)]
        standbys = sum(fault.standby for fault in losses) if self.declared.is_federated else 0
        if self.declared.is_federated and not any(hop.role == "leader" for hop in self.hops):
            return 0
        return max(0, 1 + standbys - sum(fault.begins(self.scenario.dt) < tick for fault in losses))

    @property
    def is_resumable(self) -> bool:
        """Returns whether a checkpoint has all of a flight."""
        rule = plugins.load("aggregator", self.scenario.federation.aggregation)
        return not self.declared.is_federated or bool(getattr(rule, "resumable", True))

    def _check_guided(self) -> None:
        """Validates that the controllers of UAVs whose goals change know what to do."""
        for group in self.groups if self.scenario.is_guided else ():
            if not group.declared.guided:
                cause = (
                    "`energy.battery_J` sends UAVs home" if self.scenario.energy.battery_J else "there are waypoints"
                )
                raise BadInput(
                    f"{cause}, and controller {group.scenario.method!r} flies to one goal only; leave that out, or "
                    "take a controller that is `guided`, for example cruise, orca or mfgfl-hf"
                )

    def _check_rule(self) -> None:
        """Validates the numbers that the class of the aggregation rule declares."""
        name = self.scenario.federation.aggregation
        rule: Any = plugins.load("aggregator", name)
        for declaration in ("note_bytes", "state_bytes", "complete"):
            count_of(f"aggregator {name!r}: `{declaration}` is", getattr(rule, declaration, 0), 0)

    def _check_resumable(self) -> None:
        """Validates that no leader takes over a rule whose state it cannot get."""
        standbys = any(isinstance(fault, LeaderLoss) and fault.standby for fault in self.scenario.faults)
        if standbys and not self.is_resumable:
            raise BadInput(
                f"`faults` has a standby leader, which cannot go on with the rule "
                f"{self.scenario.federation.aggregation}: its state is in one process; leave out `standby`"
            )

    def _check_until(self) -> None:
        """Validates that something reports the metric of `until`."""
        if self.scenario.until is None:
            return
        metric = Until.of_text(self.scenario.until).metric
        rule = plugins.load("aggregator", self.scenario.federation.aggregation)
        if not self.declared.is_federated or not (
            metric in self.declared.diagnostics or getattr(rule, "reports_metrics", False)
        ):
            names = ", ".join(self.declared.diagnostics) if self.declared.is_federated else ""
            raise BadInput(
                f"`until` names {metric}, which {self.method} does not report at the end of a round"
                + (f"; it reports {names}" if names else "; take a method or a learner that shares a model")
            )

    def _check_codings(self) -> None:
        """Validates that no number of a model is wider on the air than a float of the radio."""
        widest = self.scenario.radio.bits_per_float
        for key in ("payload", "broadcast_payload"):
            name = getattr(self.given.federation, key)
            if name is not None and coding_of(self.scenario, name, upload=key == "payload").bits > widest:
                raise BadInput(
                    f"`federation.{key}` {name} is wider than a float of the radio, `radio.bits_per_float` "
                    f"{widest}; take a narrower payload or a wider float"
                )

    def _check_silence(self) -> None:
        """Validates that the aggregation rule bears UAVs that send nothing."""
        federation = self.scenario.federation
        rule, threshold = federation.aggregation, federation.upload_threshold
        if threshold and not getattr(plugins.load("aggregator", rule), "bears_silence", True):
            raise BadInput(
                f"`federation.upload_threshold` is {threshold}, but with the rule {rule} UAVs whose models "
                "have settled would be silent, so that false uploads could be a majority; take fedavg, or 0"
            )

    def _check_radio(self) -> None:
        """Validates that channel and topology know stations, radios of their own, and noise, if there are any."""
        scenario, name = self.scenario, self.scenario.radio.model
        has_noise = any(isinstance(fault, Interference) for fault in scenario.faults)
        if not (scenario.stations or scenario.radios or has_noise):
            return  # nodes need not load the channel
        channel: Any = plugins.load("channel", name)
        if scenario.radios and not channel.own_radios:
            raise BadInput(
                f"there are `[[radios]]`, and the channel {name} has one radio for all; remove them, or take "
                "the channel link-budget"
            )
        if has_noise and not channel.hears_noise:
            raise BadInput(
                f"`faults` has noise, which the channel {name} does not hear; take jam, or the channel link-budget"
            )
        if not scenario.stations:
            return
        about = f"there are `[[stations]]`, and the channel {scenario.radio.model}"
        if not channel.bears_stations():
            raise BadInput(
                f"{about} has a `carry` that knows UAVs only; remove them, or let the channel declare `stations = True`"
            )
        own = next((number for number, station in enumerate(scenario.stations) if station.differs), None)
        if not channel.own_radios and own is not None:
            raise BadInput(
                f"{about} has one radio for all; remove tx_power_dbm, gain_dbi, noise_figure_db and bandwidth_hz of "
                f"`stations[{own}]`, or take the channel link-budget"
            )
        topology = topology_of(scenario)
        if scenario.federation.station is not None and not getattr(
            plugins.load("topology", topology), "bears_station", False
        ):
            raise BadInput(
                f"`federation.station` is {scenario.federation.station}, and the topology {topology} has its "
                "leader aboard a UAV; remove that key, or take the topology leader"
            )

    def _check_duty(self) -> None:
        """Validates that no node must send for longer than the radio may."""
        limit = self.scenario.radio.duty_max
        if limit is None or not self.hops:
            return
        shares = duties(self)
        node, largest = int(shares.argmax()), float(shares.max())
        if largest > limit * (1.0 + 1e-9):
            least = math.ceil(self.period_ticks * largest / limit * (1.0 - 1e-9))
            raise BadInput(
                f"`radio.duty_max` is {limit:g}, and {name_of(self.scenario, node)} would send models for "
                f"{100 * largest:.4g} % of the time; set `federation.period` to {least} at least, or shorten the models"
            )

    def _hops(self) -> tuple[Hop, ...]:
        name, federation = topology_of(self.scenario), self.scenario.federation
        kind = plugins.load("topology", name)
        if federation.clusters > 1 and not getattr(kind, "bears_clusters", True):
            raise BadInput(
                f"`federation.clusters` is {federation.clusters}, but `federation.topology` is {name}; "
                "set only one of them"
            )
        if name == LEADER and not self.declared.is_federated:
            return ()
        try:
            topology = plugins.create("topology", name, {}, self.scenario, self.declared)
            if len(self.scenario.members) < self.scenario.uavs and not getattr(topology, "bears_groups", False):
                raise BadInput(
                    f"`federation.topology` {name} needs all UAVs, and only some `[[groups]]` take part in rounds; "
                    "take the topology leader or neighbours"
                )
            hops = topology.hops()
            return linked(tuple(hops), self.scenario)
        except BadInput:
            raise
        except ValueError as error:
            raise BadInput(f"topology {name!r}: {error}") from error
        except FAILURES as error:
            raise BadInput(f"topology {name!r}: {last_line(error)}") from error

    def _check_bands(self) -> None:
        """Validates that the topology has clusters, if each of them is to have a band."""
        if self.scenario.radio.bands == "cluster" and all(hop.bands is None for hop in self.hops):
            raise BadInput(
                f"`radio.bands` is cluster, but topology {topology_of(self.scenario)} has no clusters; set "
                "`federation.clusters`, or take `radio.bands` one"
            )


def _shown_by(model: str) -> tuple[str, ...]:
    """Names of the numbers that a vehicle shows; raises BadInput if they cannot be names of columns."""
    return column_names(f"vehicle {model!r}: `columns`", getattr(plugins.load("vehicle", model), "columns", ()))


def plan_of(scenario: Scenario, where: str = "scenario") -> Plan:
    """The plan of a scenario, made when it is first asked for. `where`: source of the scenario, for an error.

    Raises:
        BadInput: see `Plan`.
    """
    plan: Plan | None = vars(scenario).get(_PLAN)
    try:
        return plan or Plan(scenario)
    except BadInput as error:
        text = str(error).removeprefix("scenario: ")  # of a scenario that the plan made
        raise BadInput(f"{where}: {text}") from error


def topology_of(scenario: Scenario) -> str:
    """Name of the topology of a scenario's rounds."""
    return scenario.federation.topology or (CLUSTERS if scenario.federation.clusters > 1 else LEADER)


def plugins_of(scenario: Scenario) -> tuple[tuple[PluginKind, str, str], ...]:
    """Kind, name and fingerprint of every plug-in that a scenario needs; none is loaded.

    Raises:
        BadInput: a plug-in is not installed here.
    """
    own = scenario.every_group_has
    named: list[tuple[PluginKind, str | None]] = [
        ("controller", None if own("method") else scenario.method),
        ("aggregator", scenario.federation.aggregation),
        ("channel", scenario.radio.model),
        ("vehicle", None if own("vehicle") else scenario.vehicle.model),
        ("topology", topology_of(scenario)),
        ("coding", scenario.upload_payload),
        ("coding", scenario.broadcast_payload),
        ("learner", None if own("training") else scenario.training.learner),
        ("filter", scenario.filter.kind),
    ]
    for group in scenario.groups:
        named += [
            ("controller", group.method),
            ("vehicle", None if group.vehicle is None else group.vehicle.model),
            ("learner", None if group.training is None else group.training.learner),
        ]
    return tuple(
        (kind, name, plugins.find(kind, name).fingerprint)
        for kind, name in dict.fromkeys(named)
        if name is not None and (kind, name) not in _NO_PLUGIN
    )


def _with_starts(scenario: Scenario) -> Scenario:
    """The scenario with the starts that its vehicles read from files, and the hashes of the files.

    A scenario that has both is returned as it is, so agents and leader need neither the files nor the vehicles.
    """
    if scenario.vehicle.file is not None and (own := [one.name for one in scenario.groups if one.vehicle is not None]):
        raise BadInput(
            f"the vehicle of all UAVs reads its movement from a file, and group {own[0]!r} has a vehicle of "
            "its own; leave out one of them, or let the groups read files of their own"
        )
    scenario = _resolved_vehicle(scenario)
    found: dict[str, Any] = {}
    for group in scenario.groups:
        if group.vehicle is None or group.vehicle.file is None:
            continue
        try:
            flown = _resolved_vehicle(of_group := scenario.alone(group))
        except (BadInput, ValueError) as error:
            raise BadInput(f"group {group.name!r}: {error}") from error
        if flown is not of_group:
            name = f"groups.{group.name}"
            found |= {f"{name}.start": as_builtins(flown.start), f"{name}.vehicle": as_builtins(flown.vehicle)}
    return scenario.replace(**found) if found else scenario


def _resolved_vehicle(scenario: Scenario) -> Scenario:
    """The scenario with the starts that the vehicle of all UAVs reads, and the hash of its file, unless it has both."""
    chosen = scenario.vehicle
    if chosen.file is None or (scenario.start.positions and chosen.options.get("sha256")):
        return scenario
    vehicle: Any = plugins.load("vehicle", chosen.model)
    try:
        found: Scenario = vehicle.resolve(plugins.options_of("vehicle", chosen.model, chosen.options), scenario)
    except BadInput:
        raise
    except FAILURES as error:
        raise BadInput(f"vehicle {chosen.model!r}: `resolve` failed: {last_line(error)}") from error
    return found
