"""How long the models of a hop are on the air: each link in a band of its own, or all one after another in one band."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock.federation.codec import Codec
from meanflock.swarm import plugins
from meanflock.swarm.errors import FAILURES, BadInput, last_line
from meanflock.swarm.scenario import Scenario


def channel_of(scenario: Scenario) -> Any:
    """The channel of a scenario; raises BadInput if it is not installed, or its options or its rate do not fit."""
    channel: Any = plugins.create("channel", scenario.radio.model, scenario.radio.options, scenario)
    channel.check_rate()
    return channel


@contextmanager
def asked_channel(scenario: Scenario) -> Iterator[None]:
    """Context in which a channel is asked; what it raises is a BadInput that names it."""
    try:
        yield
    except BadInput:
        raise
    except FAILURES as error:
        raise BadInput(f"channel {scenario.radio.model!r}: failed: {last_line(error)}") from error


def duties(plan: Any) -> NDArray[np.float64]:
    """Share of the time in which each node of a plan sends models, on average, (N + B,).

    It is that of the channel's closed form with all UAVs at their starts, without retries and collisions.

    Raises:
        BadInput: the channel is not installed, its options do not fit, or it fails.
    """
    scenario, first = plan.scenario, plan.seat(0)
    slots, channel = np.zeros(scenario.nodes), channel_of(scenario)
    for hop in plan.hops:
        if hop.is_local:
            continue
        source = first if hop.role == "leader" else None
        sends = plan.senders(hop, 0)
        targets = hop.targets_of(sends, first)
        if targets is not None:
            sends = sends[(targets != sends[:, None]).any(axis=1)]
        receivers = len(scenario.members) - 1 if targets is None else targets.shape[1]
        with asked_channel(scenario):
            lasts = channel.mean_slots(scenario, hop.codec.bits, receivers, source)
        share = scenario.federation.fraction if hop.averages == "nothing" else 1.0
        slots[sends] += share * hop.codec.count * lasts
    return slots * scenario.radio.coherence_time_s / (scenario.period_ticks * scenario.dt)


def attempt_ticks(scenario: Scenario, codec: Codec, senders: int, receivers: int, source: int | None = None) -> int:
    """Ticks from the transmission of models until all their fragments have arrived or are lost.

    In one band (`radio.access`) the fragments wait for one another, and for the acknowledgements that go before them
    with `federation.retries`. Then these are the ticks after which all are through with probability 0.999, by the
    channel's closed form with all UAVs at their starts.

    Args:
        codec: how the models are written. senders: number of UAVs that transmit at once in a band, each to `receivers`
            others. source: the node that transmits, if it is the leader's.

    Raises:
        BadInput: the channel is not installed, its options do not fit, it fails, or too many UAVs contend.
    """
    apart = codec.ticks - 1 + scenario.hop_ticks
    if scenario.radio.access == "fdma" or not senders or not receivers:
        return apart
    channel = channel_of(scenario)
    with asked_channel(scenario):
        queue = channel.queue_slots(scenario, codec.bits, senders, receivers, codec.count, codec.ticks, source)
        if scenario.federation.retries:
            queue += channel.queue_slots(scenario, codec.acknowledgement_bits, receivers, 1, senders)
    return max(apart, int(scenario.delivery_ticks(np.array(queue))))
