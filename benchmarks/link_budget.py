"""Messages and flights over a link budget beside Rice fading."""

from collections.abc import Callable
from itertools import count
from pathlib import Path

import numpy as np

from benchmarks.figure import Effort, Figure, Outcome, Say, in_turns, per_call_ms, per_tick_ms
from meanflock.channel.medium import Medium
from meanflock.federation.plan import plan_of
from meanflock.launch.engine import Engine
from meanflock.swarm import state, toml
from meanflock.swarm.mission import starts
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire.messages import FrameKind, Frames

TITLE = "A message over a link budget"
ABOUT = (
    "The states of 25 UAVs that wander around their starts, sent from all to all: 600 links with places, losses, "
    "draws, closed forms and the bill, as `Medium.send` does it. The floor is the same message over the paper's "
    "channel, `rice`, which knows no places. Below, ticks of hjb, 25 UAVs in one process, with the radio of the "
    "scenario `radio-sky`, beside those with `rice`."
)
UAVS, PLACES, CHUNK = 25, 50, 50
SLOT = "radio.coherence_time_s=0.001"
BUDGET = ("radio.model=link-budget", SLOT, "start.height=50")
MESSAGES = {
    "link-budget": BUDGET,
    "with a shadow": (*BUDGET, "radio.options.air_sigma_db=6.0"),
    "over two rays": (*BUDGET, "radio.options.air_loss=two-ray"),
    "with 3GPP's air-to-air loss, sight and shadow": (*BUDGET, "radio.options.air_loss=air-to-air"),
}
MESSAGE_RATIO, TICK_RATIO = 2.0, 1.5
FOREVER = (f"uavs={UAVS}", "stop=duration", "duration=1e6")


def message(scenario: Scenario) -> Callable[[], object]:
    """Sends the states of all UAVs from the next of some places, in the next tick."""
    medium, numbers = Medium(plan_of(scenario)), count()
    source, payload = np.arange(UAVS, dtype=np.int32), np.zeros((UAVS, scenario.state_numbers))
    frames = [Frames(FrameKind.STATE, 0, source, payload, np.zeros((0, 2), dtype=np.int32))]
    places = np.repeat(starts(scenario)[None], PLACES, axis=0)
    state.position(places)[...] += np.random.default_rng(1).normal(0.0, 1.0, (PLACES, UAVS, scenario.dimensions))

    def send() -> None:
        tick = next(numbers)
        medium.send(tick, frames, places[tick % PLACES])
        medium.due(tick)

    return send


def run(effort: Effort, say: Say) -> Outcome:
    """Messages in turns, then ticks in turns."""
    say("messages")
    sends = {name: message(load(None, [f"uavs={UAVS}", *keys])) for name, keys in {"rice": (SLOT,), **MESSAGES}.items()}
    turns = effort.choose(40, 6)
    us = in_turns(turns, {name: lambda send=send: 1e3 * per_call_ms(send, CHUNK) for name, send in sends.items()})
    say("ticks")
    sky = toml.found(Path("radio-sky"))
    flights = {"rice": load(None, FOREVER, method="hjb"), "sky": load(sky, FOREVER, method="hjb")}
    ticks = {name: Engine(flown, "benchmark").fly() for name, flown in flights.items()}
    ms = in_turns(turns, {name: lambda flight=flight: per_tick_ms(flight, CHUNK) for name, flight in ticks.items()})
    rice, tick = Figure("message, rice", "µs", us["rice"]), Figure("tick, hjb, rice", "ms/tick", ms["rice"])
    return Outcome(
        [
            *(Figure(f"message, {name}", "µs", us[name], floor=rice, ratio_target=MESSAGE_RATIO) for name in MESSAGES),
            rice,
            Figure("tick, hjb, radio-sky", "ms/tick", ms["sky"], floor=tick, ratio_target=TICK_RATIO),
            tick,
        ]
    )
