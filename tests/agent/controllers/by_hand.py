"""Steps of a controller by hand."""

import numpy as np

from meanflock.agent.controllers.base import Controller, Step
from meanflock.swarm import declared
from meanflock.swarm.scenario import load

DISCS = "obstacles=[{centre=[10.0, 0.0], radius=2.0}, {centre=[-30.0, 40.0], radius=5.0}]"


def made(method: str, *settings: str, uavs: int = 2) -> Controller:
    """The controller of a scenario without drag, so that what it commands is what the source says."""
    wanted = [f"uavs={uavs}", "wind.drag=0", *settings]
    return declared.controller(load(None, wanted, method=method))


def stepped(controller: Controller, states: np.ndarray) -> Step:
    """A first step of all UAVs in states (N, 4), each of which everybody knows exactly."""
    memory = controller.init(np.arange(len(states)), states)
    return controller.step(memory, 0, states, ())


def accelerations(method: str, states: np.ndarray, *settings: str) -> np.ndarray:
    """Of such a step, (N, 2)."""
    return stepped(made(method, *settings, uavs=len(states)), states).acceleration
