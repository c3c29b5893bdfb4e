"""Cut of models that are too long for one message: its size, and the codecs of a scenario's hops that share it."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock.federation.band import asked_channel, channel_of
from meanflock.federation.codec import HEAD_BYTES, Codec, Cut
from meanflock.federation.coding import check_form
from meanflock.federation.codings.base import Coding
from meanflock.federation.seat import seat
from meanflock.swarm import plugins
from meanflock.swarm.declared import Declared
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import BEYOND_SENSE

WHOLE = 0  # value of `federation.fragment`: no model is cut
WHOLE_FROM = 0.5  # expected share of whole models that are delivered, from which they go whole in space
SUCCESS = 0.95  # expected share of fragments that are delivered, from which a size is long enough


class Codecs:
    """The codecs of a scenario's models, which have one cut.

    Attributes:
        upload: of the models that UAVs send. broadcast: of global models.
    """

    def __init__(self, scenario: Scenario, declared: Declared) -> None:
        """It may ask the channel, so make it once.

        Raises:
            BadInput: a coding, the aggregation rule or the channel is not installed, its options do not fit, or the
                channel fails.
            ValueError: a fragment has no room.
        """
        federation = scenario.federation
        up = coding_of(scenario, scenario.upload_payload, upload=True)
        down = coding_of(scenario, scenario.broadcast_payload)
        self._floats = coding_of(scenario, scenario.radio_payload)
        self._declared = declared
        rule = plugins.load("aggregator", federation.aggregation)
        note = max(declared.note_bytes, getattr(rule, "note_bytes", 0))
        self._head = HEAD_BYTES + note if note or declared.dated else 0
        self._cut: Cut | None = None
        sent = [self._codec(up, weighted=declared.weighted), self._codec(down)]
        if federation.clusters > 1:
            sent.append(self.relay(np.ones(0, dtype=np.intp)))
        self._cut = _cut_of(scenario, declared.parts, sent)
        self.upload = self._codec(up, weighted=declared.weighted)
        self.broadcast = self._codec(down)

    def relay(self, most: NDArray[np.intp]) -> Codec:
        """The codec of averages of `most` (N,) models at most, as heads of clusters send them: floats of the radio. A
        coarser coding would lose what no later upload gives back."""
        return self._codec(self._floats, weighted=self._declared.weighted, most=most)

    def _codec(self, coding: Coding, *, weighted: bool = False, most: NDArray[np.intp] | None = None) -> Codec:
        parts = self._declared.parts if most is None else (self._declared.parameters,)
        return Codec(coding, parts, self._cut, weighted=weighted, head=self._head, most=most)


def coding_of(scenario: Scenario, name: str, *, upload: bool = False) -> Coding:
    """The coding of a name; of an upload with the options of the scenario.

    Raises:
        BadInput: it is not installed, its options do not fit, or a declaration is invalid.
    """
    options = scenario.federation.payload_options if upload else {}
    coding: Coding = plugins.create("coding", name, options, scenario)
    check_form(coding)
    return coding


def bound_of_models(scenario: Scenario) -> float:
    """Size that every number of a model must be below, so that it can be sent."""
    coding = coding_of(scenario, scenario.upload_payload, upload=True)
    return min(BEYOND_SENSE, math.nextafter(coding.largest, math.inf))


def _cut_of(scenario: Scenario, parts: tuple[int, ...], sent: Sequence[Codec]) -> Cut | None:
    """The cut of all models that a scenario transmits, by the longest of them; None: they go whole.

    `sent`: their codecs, if they went whole. Raises ValueError if a fragment has no room for a number, or for a note.
    """
    slots, bits = scenario.federation.fragment, max(codec.bits for codec in sent)
    if slots is None:
        is_whole = _fits(scenario, bits)
        if is_whole and scenario.dimensions == 3:  # in the plane models are cut by their length alone
            is_whole = share_delivered(scenario, bits) >= WHOLE_FROM
        slots = WHOLE if is_whole else longest(scenario)
    if slots == WHOLE:
        return None
    radio, forms = scenario.radio, [codec.form for codec in sent]
    per_slot = channel_of(scenario).bits_per_slot
    size = min(form.size(int(slots * per_slot / 8), parts) for form in forms)
    if size < 1:
        raise ValueError(f"a fragment of {slots} slots has no room for a weight; set a larger `federation.fragment`")
    step = max(form.step for form in forms)
    size -= size % step
    if (head := max(form.head_numbers for form in forms)) > size:
        raise ValueError(
            f"a fragment of {slots} slots has no room for a note of {forms[0].head - HEAD_BYTES} bytes; declare a "
            "smaller `note_bytes`, or set a larger `federation.fragment`"
        )
    busy = radio.latency_threshold_slots * radio.coherence_time_s
    if size >= head + sum(parts):
        return None
    return Cut(slots, size, max(1, int(scenario.dt / busy * (1.0 + 1e-9))))


def longest(scenario: Scenario) -> int:
    """Slots of the longest fragments of which 95 % are expected to be delivered, at least 1.

    The expectation is that of the links between the node where the leader averages and all other UAVs at take-off. A
    channel without closed forms gets a quarter of the latency threshold.

    Raises:
        BadInput: the channel is not installed, its options do not fit, or it fails.
    """
    limit, others = scenario.radio.latency_threshold_slots, _uploaders(scenario)
    channel = channel_of(scenario)
    for slots in range(limit, 0, -1):
        lost = _expected_losses(channel, scenario, int(slots * channel.bits_per_slot / 8) * 8)
        if lost is None:
            return max(1, limit // 4)
        if lost <= (1.0 - SUCCESS) * others:
            return slots
    return 1


def share_delivered(scenario: Scenario, bits: int) -> float:
    """Expected share of messages of so many bits that are delivered to where the leader averages, at take-off; 1 if
    unknown.

    Raises:
        BadInput: the channel is not installed, its options do not fit, or it fails.
    """
    lost = _expected_losses(channel_of(scenario), scenario, bits)
    others = _uploaders(scenario)
    return 1.0 if lost is None or not others else 1.0 - lost / others


def _uploaders(scenario: Scenario) -> int:
    """Number of UAVs whose uploads go by radio."""
    return len(scenario.members) - (seat(scenario) < scenario.uavs)


def _expected_losses(channel: Any, scenario: Scenario, bits: int) -> float | None:
    """Expected losses of an upload of so many bits from every other UAV to where the leader averages, summed; None if
    unknown.

    Raises BadInput if the channel fails.
    """
    target = seat(scenario)
    source = np.setdiff1d(scenario.members, [target])
    with asked_channel(scenario):
        expected = channel.at_start(scenario, source, np.full_like(source, target), bits)
    return None if expected is None else float(expected[0])


def _fits(scenario: Scenario, bits: int) -> bool:
    """Returns whether a message of so many bits can arrive within the latency threshold, or without a loss in a hop.

    A channel that does not say how long a message takes is taken to be fast enough. Raises as `longest`.
    """
    channel = channel_of(scenario)
    with asked_channel(scenario):
        least = channel.least_slots(bits)
        if least is None or least <= scenario.radio.latency_threshold_slots:
            return True
    in_time = int(scenario.delivery_ticks(np.array(least))) <= scenario.hop_ticks
    return in_time and _expected_losses(channel, scenario, bits) == 0.0
