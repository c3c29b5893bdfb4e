"""How long the models of a hop are on the air: each link in a band of its own, or all one after another in one band."""

from typing import Any

import numpy as np

from meanflock.federation.codec import Codec
from meanflock.swarm import plugins
from meanflock.swarm.errors import FAILURES, BadInput, last_line
from meanflock.swarm.scenario import Scenario


def channel_of(scenario: Scenario) -> Any:
    """The channel of a scenario; raises BadInput if it is not installed, or its options or its rate do not fit."""
    channel: Any = plugins.create("channel", scenario.radio.model, scenario.radio.options, scenario)
    channel.check_rate()
    return channel


def attempt_ticks(scenario: Scenario, codec: Codec, senders: int, receivers: int) -> int:
    """Ticks from the transmission of models until all their fragments have arrived or are lost.

    In one band (`radio.access`) the fragments wait for one another, and for the acknowledgements that go before them
    with `federation.retries`. Then these are the ticks after which all are through with probability 0.999, by the
    channel's closed form with all UAVs at their starts.

    Args:
        codec: how the models are written. senders: number of UAVs that transmit at once in a band, each to `receivers`
            others.

    Raises:
        BadInput: the channel is not installed, its options do not fit, or too many UAVs contend.
        ValueError: the channel fails.
    """
    apart = codec.ticks - 1 + scenario.hop_ticks
    if scenario.radio.access == "fdma" or not senders or not receivers:
        return apart
    channel = channel_of(scenario)
    try:
        queue = channel.queue_slots(scenario, codec.bits, senders, receivers, codec.count, codec.ticks)
        if scenario.federation.retries:
            queue += channel.queue_slots(scenario, codec.acknowledgement_bits, receivers, 1, senders)
    except BadInput:
        raise
    except FAILURES as error:
        raise ValueError(f"channel {scenario.radio.model!r}: failed: {last_line(error)}") from error
    return max(apart, int(scenario.delivery_ticks(np.array(queue))))
