"""An agent node of three UAVs of eight, and what it is sent."""

from typing import Any

import numpy as np

from meanflock.agent.node import Agent
from meanflock.net import keys
from meanflock.swarm import scenario, state
from meanflock.swarm.mission import starts
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire import control
from meanflock.swarm.wire.control import FLOAT_OF_BITS
from meanflock.swarm.wire.messages import Frames, Sense, Welcome

RUN = "node-test"
NUMBER = keys.fingerprint(RUN)
UAVS = (2, 3, 5)  # of eight


def flown(*settings: str, method: str = "mfgfl-hf") -> Scenario:
    return load(None, ["uavs=8", "federation.period=5", f"method={method}", *settings])


def welcome(case: Scenario, uavs: tuple[int, ...] = UAVS) -> Welcome:
    """Of an agent, or of the leader if there are no UAVs."""
    plan = starts(case).astype(FLOAT_OF_BITS[case.radio.bits_per_float])
    return Welcome(NUMBER, f"agent-{uavs[0]}" if uavs else "leader", uavs, 0, scenario.encode(case), plan)


def states_at(tick: int, uavs: tuple[int, ...] = UAVS) -> state.States:
    """Made-up states of some UAVs: the same UAV is at the same place whoever holds it."""
    everyone = np.random.default_rng(tick).uniform([0, 0, -5, -5], [160, 110, 5, 5], (8, 4))
    return everyone[list(uavs)]


def sense(tick: int, *inbox: Frames, uavs: tuple[int, ...] = UAVS, states: np.ndarray | None = None) -> Sense:
    return Sense(NUMBER, tick, states_at(tick, uavs) if states is None else states, True, False, inbox)


def kept(agent: Agent, tick: int) -> dict[str, Any]:
    """What an agent replies to a request for all that it remembers."""
    return control.decode_record(agent.act(Sense(NUMBER, tick, states_at(tick), True, True)).memory)
