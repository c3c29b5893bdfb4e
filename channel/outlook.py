"""Expected share of a scenario's models that its radio will lose, by the channel's closed form, before take-off."""

import logging
import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import msgspec
import numpy as np

from meanflock.channel.base import Channel, failed
from meanflock.channel.contention import share_collided
from meanflock.federation.cut import longest
from meanflock.federation.plan import Plan, plan_of
from meanflock.federation.seat import seat
from meanflock.federation.topology.base import Hop, Indices
from meanflock.swarm import logs, plugins, state
from meanflock.swarm.errors import FAILURES, BadInput
from meanflock.swarm.mission import starts
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import FrameKind

WARN_FROM = 0.5  # share of lost whole models from which a warning is given
WARN_FROM_FRAGMENTS = 0.9  # and of lost fragments: each is averaged over the UAVs whose copy arrived
_ACCEPTABLE = 0.2  # share of lost messages that a suggested remedy leaves at most
_LINKS_AT_ONCE = 2**20
_LINKS_AT_MOST = 2**24  # of more, those of some senders, evenly spaced, are looked at
_MOST_SLOTS = 2**14  # latency threshold up to which a remedy is searched for


class Outlook(NamedTuple):
    """Expected loss of one kind of model at take-off.

    message: "upload", "relay" or "global model". bits: of one transmission. slots: least number that it takes; None if
    the channel does not say. limit: slots after which it is lost. lost: share of the links that lose it. fragments:
    number of transmissions of a model; 1 if it is sent whole. ticks: in which these are transmitted. collided: share of
    the transmissions that are lost in collisions; `lost` includes them.
    """

    message: str
    bits: int
    slots: int | None
    limit: int
    lost: float
    fragments: int = 1
    ticks: int = 1
    collided: float = 0.0

    @property
    def is_bad(self) -> bool:
        """Returns whether so much will be lost that a warning is due."""
        return self.lost >= (WARN_FROM if self.fragments == 1 else WARN_FROM_FRAGMENTS)

    def __str__(self) -> str:
        collide = f"; {100 * self.collided:.3g} % collide" if self.collided else ""
        if self.fragments > 1:
            size = "" if self.slots is None else f" and {_number(self.slots, 'slot')}"
            return (
                f"each {self.message} is sent in {self.fragments} fragments of {self.bits:,} bits{size}, in "
                f"{_number(self.ticks, 'tick')}: "
                f"{100 * (1 - self.lost):.3g} % of the fragments will be delivered{collide}"
            )
        takes = "" if self.slots is None else f" takes {_number(self.slots, 'slot')}; the limit is {self.limit}"
        article = "an" if self.message == "upload" else "a"
        return f"{article} {self.message} of {self.bits:,} bits{takes}: {100 * self.lost:.3g} % will be lost{collide}"


def _number(count: int, unit: str) -> str:
    return f"{count} {unit}{'s' * (count > 1)}"


_NAMES = {FrameKind.UPLOAD: "upload", FrameKind.RELAY: "relay", FrameKind.GLOBAL: "global model"}
_PAYLOAD_KEYS = {FrameKind.UPLOAD: "federation.payload", FrameKind.GLOBAL: "federation.broadcast_payload"}


def outlooks(scenario: Scenario) -> list[Outlook]:
    """The expected loss of every kind of model that a scenario sends, with all UAVs at their starts.

    Returns:
        An empty list without rounds, or if the channel has no closed form.

    Raises:
        BadInput: the channel is not installed, or its options do not fit.
        RunFailed: its closed form fails.
    """
    plan = plan_of(scenario)
    if not plan.hops:
        return []
    channel: Channel = plugins.create("channel", scenario.radio.model, scenario.radio.options, plan.scenario)
    found = (_outlook(plan.given, channel, hop) for hop in plan.hops if not hop.is_local)
    return [one for one in found if one is not None]


def remedies(scenario: Scenario, message: str) -> str:
    """A sentence with settings, each of which alone would deliver most models of a kind."""
    settings = list(_settings(scenario, message))
    return f"Use {', '.join(settings[:-1])}{' or ' * (len(settings) > 1)}{settings[-1]}"


def notes(scenario: Scenario) -> Iterator[tuple[str, int]]:
    """How the models of a scenario are cut, and a warning of those that will mostly be lost.

    Returns:
        Texts, each with its level of the log.
    """
    for one in outlooks(scenario):
        if one.is_bad:
            yield f"{one}. {remedies(scenario, one.message)}", logging.WARNING
        elif one.fragments > 1:
            yield str(one), logging.INFO


def warn_of_lost_models(scenario: Scenario) -> None:
    """Print the notes of a scenario on standard error."""
    for text, level in notes(scenario):
        logs.note(text, level)


def _outlook(scenario: Scenario, channel: Channel, hop: Hop) -> Outlook | None:
    """Expected loss of the models of a hop; None if no radio carries them or the channel has no closed form."""
    radio, range_m = scenario.radio, scenario.federation.range_m or math.inf
    bits = hop.codec.bits
    links, lost = 0, 0.0
    try:
        for source, target in _links(scenario, hop):
            expected = channel.at_start(scenario, source, target, bits, hop.label.name.lower(), range_m)
            if expected is None:
                return None
            links += len(source)
            lost += expected[0]
        slots = channel.least_slots(bits)
        if hop.role == "leader":
            slots = channel.least_slots_from(seat(scenario), bits)
    except FAILURES as error:
        raise failed(radio.model, error) from error
    if not links:
        return None
    collided, codec = _collided(scenario, hop), hop.codec
    lost = 1.0 - (1.0 - collided) * (1.0 - lost / links)
    limit = radio.latency_threshold_slots
    return Outlook(_NAMES[hop.label], bits, slots, limit, lost, codec.count, codec.ticks, collided)


def _collided(scenario: Scenario, hop: Hop) -> float:
    """Expected share of the transmissions of a hop that are lost in collisions: of broadcasts by contention."""
    if scenario.radio.access != "csma" or hop.targets is not None:
        return 0.0
    senders = len(_senders(scenario, hop))
    if hop.averages == "nothing":
        senders = min(senders, scenario.participants)
    turn = 1 if hop.codec.cut is None else hop.codec.cut.per_tick
    turns = [min(turn, hop.codec.count - first) for first in range(0, hop.codec.count, turn)]
    return sum(frames * float(share_collided(np.full(senders, frames))[0]) for frames in turns) / hop.codec.count


def _senders(scenario: Scenario, hop: Hop) -> Indices:
    """The nodes that transmit in a hop of the first round; of the leader's hops the one where it averages, or all
    stations."""
    if not hop.by_station or hop.role == "agent":
        return plan_of(scenario).senders(hop, 1)
    return hop.senders[hop.senders >= scenario.uavs]


def _links(scenario: Scenario, hop: Hop) -> Iterator[tuple[Indices, Indices]]:
    """Sources and targets (K,) of the links of a hop by radio at take-off; some senders at a time, to save memory.

    Of a large swarm they are the links of some senders.
    """
    places = state.position(starts(scenario))
    targets = scenario.members[None] if hop.targets is None else hop.targets
    width = targets.shape[1]
    some = max(1, _LINKS_AT_ONCE // width)
    every = _senders(scenario, hop)
    if len(every) * width > _LINKS_AT_MOST:
        every = every[:: -(-len(every) * width // _LINKS_AT_MOST)]
    for first in range(0, len(every), some):
        senders = every[first : first + some]
        source = senders.repeat(width)
        target = (np.tile(targets[0], len(senders)) if hop.targets is None else targets[senders]).ravel()
        chosen = source != target
        if hop.range_m is not None:  # UAVs farther away are not addressed
            chosen &= np.linalg.norm(places[source] - places[target], axis=-1) <= hop.range_m
        if chosen.any():
            yield source[chosen], target[chosen]


def _settings(scenario: Scenario, message: str) -> Iterator[str]:
    """What would deliver most models of a kind, each alone: settings with the share that would still be lost.

    Where fragments get through, no longer wait is needed.
    """
    changes: list[tuple[str, Any]] = []
    today = next(one for one in outlooks(scenario) if one.message == message)
    if today.collided and (lost := _lost(scenario, message, "radio.access", "tdma")) < WARN_FROM:
        yield f"radio.access=tdma ({100 * lost:.2g} % lost)"
        return
    short = longest(scenario)
    lost = _lost(scenario, message, "federation.fragment", short)
    if is_cut := lost < min(today.lost, WARN_FROM_FRAGMENTS):
        yield f"federation.fragment={short} ({100 * lost:.2g} % lost)"
    changes += [(key, "int8") for label, key in _PAYLOAD_KEYS.items() if _NAMES[label] == message]
    changes.append(("radio.bits_per_float", 16))
    slots, limit = scenario.radio.latency_threshold_slots, "radio.latency_threshold_slots"
    while not is_cut and slots < _MOST_SLOTS and _lost(scenario, message, limit, slots) > _ACCEPTABLE:
        slots += max(1, slots // 8)
    if not is_cut:
        changes.append((limit, slots))
    for path, value in changes:
        if (lost := _lost(scenario, message, path, value)) <= _ACCEPTABLE:
            yield f"{path}={value} ({100 * lost:.2g} % lost)"
    yield "fewer parameters"


def _lost(scenario: Scenario, message: str, path: str, value: Any) -> float:
    """Share of the models of a kind that would be lost with another value of a key; 1 if the value does not fit."""
    table, key = path.split(".")
    plan = plan_of(scenario)
    try:
        part = msgspec.structs.replace(getattr(plan.given, table), **{key: value})
        changed = msgspec.structs.replace(plan.given, **{table: part})
        Plan(changed, plan.declared)  # no radio changes what a controller declares
    except (ValueError, BadInput):  # other keys need wider floats, or longer rounds
        return 1.0
    return next(one.lost for one in outlooks(changed) if one.message == message)
