"""Remarks on a radio before take-off: its rate and noise, and the expected losses of links of three lengths."""

from collections.abc import Iterator

import numpy as np

from meanflock.channel.base import Channel
from meanflock.channel.contention import share_collided
from meanflock.channel.fading.link_budget import THERMAL_DBM_HZ, LinkBudget
from meanflock.federation.plan import plan_of
from meanflock.swarm import plugins
from meanflock.swarm.scenario import Scenario

MOST_EFFICIENT = 8.0  # bit/s/Hz of a link with one antenna at each end; 5.55 is the best row of the CQI table
_DISTANCES_M = np.array([100.0, 300.0, 1000.0])
_OF_THE_PAPER = "rice"


def remarks(scenario: Scenario) -> Iterator[str]:
    """Lines about the radio of a scenario: budget, expected losses at three distances, and what is not believable.

    Raises:
        BadInput: the scenario cannot be flown here.
    """
    plan = plan_of(scenario)
    flown, radio = plan.scenario, plan.scenario.radio
    channel: Channel = plugins.create("channel", radio.model, radio.options, flown)
    efficiency = channel.bits_per_slot / (radio.coherence_time_s * radio.bandwidth_hz)
    yield (
        f"radio {radio.model}: {radio.tx_power_dbm:g} dBm, {radio.bandwidth_hz / 1e6:g} MHz, "
        f"{efficiency:.3g} bit/s/Hz, "
        f"{channel.bits_per_slot:,.0f} bits in a slot of {1e3 * radio.coherence_time_s:g} ms; access {radio.access}"
    )
    bits = max((hop.codec.bits for hop in plan.hops), default=flown.state_numbers * radio.bits_per_float)
    for distance in _DISTANCES_M:
        if (found := channel.expected(np.array([distance]), bits)) is not None:
            margin = f"margin {channel.margin_db(distance):.1f} dB, " if isinstance(channel, LinkBudget) else ""
            yield f"between UAVs at {distance:.0f} m: {margin}{_percent(found[0])} of messages of {bits:,} bits lost"
    yield from _to_stations(channel, flown, bits)
    if radio.access == "csma":
        collided = share_collided(np.ones(flown.uavs, dtype=np.intp))[0]
        yield f"{100 * collided:.3g} % of broadcasts collide and are lost where all {flown.uavs} UAVs send one at once"
    if efficiency > MOST_EFFICIENT:
        whose = "the paper's; " if radio.model == _OF_THE_PAPER else ""
        yield (
            f"{whose}{efficiency:.3g} bit/s/Hz is more than radios reach, {MOST_EFFICIENT:g}; --radio radio-sky has a "
            "link budget"
        )
    if radio.model == _OF_THE_PAPER and radio.noise_psd_dbm_hz < THERMAL_DBM_HZ:
        yield f"a noise of {radio.noise_psd_dbm_hz:g} dBm/Hz is below that of a resistor, {THERMAL_DBM_HZ:g} dBm/Hz"


def _to_stations(channel: Channel, flown: Scenario, bits: int) -> Iterator[str]:
    """Lines about the links from UAVs to each station, over all shadows and lines of sight."""
    for number, station in enumerate(flown.stations):
        node, height = flown.uavs + number, station.place[2]
        for distance in _DISTANCES_M:
            slant = np.array([np.hypot(distance, flown.start.height - height)])
            found, margin = channel.expected(slant, bits), ""
            if isinstance(channel, LinkBudget):
                found = channel.expected_to(node, np.array([distance]), bits)
                margin = f"margin in sight {channel.margin_db(distance, node):.1f} dB, "
            if found is not None:
                yield (
                    f"to station {number}, {height:g} m up, {distance:.0f} m away on the ground: {margin}"
                    f"{_percent(found[0])} of such messages lost"
                )


def _percent(lost: float) -> str:
    return f"{100 * lost:.3g} %" if lost >= 1e-8 else "0 %"
