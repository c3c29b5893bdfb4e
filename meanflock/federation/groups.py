"""Groups: the UAVs of a plan by their controllers, and what all groups declare together."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.swarm import mission, plugins
from meanflock.swarm.declared import Declared, controller, declarations_of
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario, with_defaults
from meanflock.swarm.state import contains


class Group(NamedTuple):
    """UAVs that one controller flies, behind one filter. Groups of a scenario with equal controllers are one.

    uavs: (M,) ascending. scenario: resolved, as their controller gets it. declared: the declarations of the controller.
    takes_part: whether they take part in rounds. hears: (N,), UAVs whose broadcasts their controller understands; None:
    those of all.
    """

    uavs: NDArray[np.intp]
    scenario: Scenario
    declared: Declared
    takes_part: bool
    hears: NDArray[np.bool_] | None = None


def group_number(groups: Sequence[Group], uavs: NDArray[np.intp]) -> int:
    """Number of the group that has all of some UAVs, ascending.

    Raises:
        BadInput: there is none.
    """
    for number, group in enumerate(groups):
        if contains(group.uavs, uavs).all():
            return number
    raise BadInput(f"UAVs {', '.join(map(str, uavs))} are of several groups, and a node has UAVs of one")


def grouped(scenario: Scenario, declared: Declared | None) -> tuple[Scenario, Declared, tuple[Group, ...]]:
    """Divides the UAVs of a scenario by their controllers.

    Args:
        declared: the declarations of the controller, where that is not found by its name.

    Returns:
        The scenario, resolved; what all groups declare together; and the groups, in the order of their first UAVs.

    Raises:
        BadInput: a controller cannot be made, or groups contradict each other.
    """
    if not scenario.groups:
        alone = _declared(scenario) if declared is None else declared
        whole = _resolved(scenario, alone)
        if alone.recorded:
            options: dict[str, Any] = scenario.controller | dict(alone.recorded)
            whole = msgspec.structs.replace(whole, controller=options)
        return whole, alone, (Group(np.arange(scenario.uavs), whole, alone, alone.is_federated),)
    if declared is not None:
        raise BadInput("there are `[[groups]]`, and one controller for all UAVs is given; remove the groups")
    each: list[Declared] = []
    of_groups = [scenario.of_group(group) for group in scenario.groups]
    for number, (group, flown) in enumerate(zip(scenario.groups, of_groups, strict=True)):
        first = of_groups.index(flown)
        try:
            if group.vehicle is not None:  # so that its errors name the group
                plugins.options_of("vehicle", group.vehicle.model, group.vehicle.options)
            each.append(_declared(flown) if first == number else each[first])
        except BadInput as error:
            raise BadInput(f"group {group.name!r}: {error}") from error
    taking_part = _taking_part(scenario, each)
    all_declare = _joint(scenario, each, taking_part)
    whole = _resolved(scenario, all_declare)
    recorded = [
        msgspec.structs.replace(group, controller=scenario.of_group(group).controller | dict(own.recorded))
        if own.recorded
        else group
        for group, own in zip(scenario.groups, each, strict=True)
    ]
    federation = whole.federation
    if any(taking_part) and not all(taking_part):
        names = tuple(group.name for group, is_in in zip(scenario.groups, taking_part, strict=True) if is_in)
        federation = msgspec.structs.replace(federation, group=names[0] if len(names) == 1 else names)
    whole = msgspec.structs.replace(whole, groups=tuple(recorded), federation=federation)
    return whole, all_declare, _by_controller(whole, each, taking_part)


def _declared(scenario: Scenario) -> Declared:
    return declarations_of(controller(scenario), scenario.method)


def _resolved(scenario: Scenario, declared: Declared) -> Scenario:
    """The scenario with the period of the controller and the payloads of the radio."""
    return with_defaults(scenario, period=scenario.federation.period or declared.period_ticks)


def _taking_part(scenario: Scenario, each: Sequence[Declared]) -> list[bool]:
    """Whether each group takes part in rounds.

    Raises:
        BadInput: a group that is named in `federation.group` shares no model.
    """
    named = scenario.federation.groups
    taking_part = []
    for group, declared in zip(scenario.groups, each, strict=True):
        if group.name in named and not declared.is_federated:
            raise BadInput(
                f"`federation.group` names {group.name!r}, whose controller {scenario.of_group(group).method!r} shares "
                "no model; leave it out, or give that group a learner"
            )
        taking_part.append(declared.is_federated and (not named or group.name in named))
    return taking_part


def _joint(scenario: Scenario, each: Sequence[Declared], taking_part: Sequence[bool]) -> Declared:
    """What all groups declare together: of the model and the rounds what those declare that take part; the diagnostics
    of all; else the largest.

    Raises:
        BadInput: groups that take part share models of different sizes, have rounds at different times, or exclude the
            UAV of the leader.
    """
    sharing = [number for number, is_in in enumerate(taking_part) if is_in]
    first = each[sharing[0] if sharing else 0]
    for number in sharing[1:]:
        names = f"groups {scenario.groups[sharing[0]].name!r} and {scenario.groups[number].name!r}"
        if (own := each[number].parts) != first.parts:
            raise BadInput(
                f"{names} share models of {first.parameters} and {each[number].parameters} numbers, in parts of "
                f"{list(first.parts)} and {list(own)}; name one of them in `federation.group`"
            )
        if (ticks := each[number].period_ticks) != first.period_ticks and scenario.federation.period is None:
            raise BadInput(f"{names} have rounds every {first.period_ticks} and {ticks} ticks; set `federation.period`")
    members = [rows for (_, rows), is_in in zip(mission.parts(scenario), taking_part, strict=True) if is_in]
    leader = scenario.federation.leader
    if members and scenario.federation.station is None and not any(r.start <= leader < r.stop for r in members):
        places = ", ".join(f"{rows.start}…{rows.stop - 1}" for rows in members)
        remedy = f"set `federation.leader={members[0].start}`, or another of UAVs {places}"
        raise BadInput(f"`federation.leader` is UAV {leader}, which takes no part in rounds; {remedy}")
    weights = [declared.weights for declared in each if declared.weights]
    busy = list(dict.fromkeys(declared.busy for declared in each if declared.busy))
    counts = list(dict.fromkeys(name for declared in each for name in declared.measured[-1:]))
    for found in (busy, counts):
        if len(found) > 1:
            raise BadInput(f"groups call the same diagnostic of trainings {' and '.join(found)}; give it one name")
    return msgspec.structs.replace(
        first,
        parameters=first.parameters if sharing else 0,
        parts=first.parts if sharing else (),
        weights=first.weights if sharing else max(weights, default=0),
        diagnostics=tuple(dict.fromkeys(name for declared in each for name in declared.diagnostics)),
        broadcast_numbers=max(declared.broadcast_numbers for declared in each),
        pairwise=any(declared.pairwise for declared in each),
        shares=any(declared.shares for declared in each),
        weighted=any(each[number].weighted for number in sharing),
        note_bytes=max((each[number].note_bytes for number in sharing), default=0),
        dated=any(each[number].dated for number in sharing),
        busy="".join(busy),
        measured=(*dict.fromkeys(name for declared in each for name in declared.measured[:-1]), *counts),
        guided=all(declared.guided for declared in each),
        recorded={},
    )


def _by_controller(scenario: Scenario, each: Sequence[Declared], taking_part: Sequence[bool]) -> tuple[Group, ...]:
    """The groups of a resolved scenario; those with equal controllers are one."""
    groups: list[Group] = []
    for (table, rows), declared, is_in in zip(mission.parts(scenario), each, taking_part, strict=True):
        flown, uavs = scenario.of_group(table), np.arange(rows.start, rows.stop)
        same = next((n for n, one in enumerate(groups) if (one.scenario, one.takes_part) == (flown, is_in)), None)
        if same is None:
            groups.append(Group(uavs, flown, declared, is_in))
        else:
            groups[same] = groups[same]._replace(uavs=np.concatenate([groups[same].uavs, uavs]))
    if len(groups) == 1:
        return tuple(groups)
    return tuple(one._replace(hears=_heard(one, groups, scenario.uavs)) for one in groups)


def _heard(listener: Group, groups: Sequence[Group], uavs: int) -> NDArray[np.bool_]:
    """Mask (N,) of the UAVs whose broadcasts a group understands: of the same method, or states that both share."""
    heard = np.zeros(uavs, dtype=bool)
    for group in groups:
        if group.scenario.method == listener.scenario.method or (group.declared.shares and listener.declared.shares):
            heard[group.uavs] = True
    return heard
