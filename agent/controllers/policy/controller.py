"""The controller `policy`."""

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from meanflock.agent.controllers import base
from meanflock.agent.controllers.base import Controller, Memory, Received, Step
from meanflock.agent.controllers.policy.network import TRAINED, Network, read
from meanflock.agent.controllers.policy.perception import Perception
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import States, Vectors


class PolicyController(Controller):
    """Flies a policy that was trained in `meanflock.env` and saved to a file.

    The scenario records the SHA-256 of the file. A node whose file has another one is refused. Without a file it flies
    the policy that is installed for the plane or for space, which `examples/train.py` trained.
    """

    name = "policy"
    guided = True
    dimensions = (2, 3)
    shares = True
    pairwise = True

    class Options(base.Options, frozen=True):
        """The options of `policy`."""

        file: Annotated[
            str, Meta(description="the saved policy, on every host that flies it; unset: the installed one")
        ] = ""
        sha256: Annotated[str, Meta(description="SHA-256 of the file, 64 hexadecimal digits; filled in if unset")] = ""

    def __init__(self, options: Any, scenario: Scenario) -> None:
        super().__init__(options, scenario)
        self._network = self._read(options, scenario.dimensions)
        self._perception = Perception(scenario, self._network.neighbours, self._network.message)
        self.broadcast_numbers = self._perception.broadcast_numbers

    def _read(self, options: Any, dimensions: int) -> Network:
        path = options.file or TRAINED[dimensions]
        network, sha256 = read(path)
        if options.sha256 not in ("", sha256):
            remedy = "copy the same file to" if options.file else "install the same meanflock on"
            raise BadInput(
                f"policy {path} has the SHA-256 {sha256} here, and the scenario wants {options.sha256}; "
                f"{remedy} every host"
            )
        if network.axes != dimensions:
            raise BadInput(
                f"policy {path} flies in {network.axes} dimensions, and `space.dimensions` is {dimensions}; train one "
                f"in an environment of {dimensions} dimensions, or leave out `controller.file` for the installed one"
            )
        self.recorded = {"sha256": sha256}
        return network

    def init(self, uavs: NDArray[np.intp], plan: States) -> Memory:
        return self._perception.init(uavs, plan)

    def guide(self, memory: Memory, rows: NDArray[np.intp], goals: Vectors) -> Memory:
        return self._perception.guide(memory, rows, goals)

    def step(self, memory: Memory, tick: int, own: States, received: Sequence[Received]) -> Step:
        memory, refused = self._perception.receive(memory, tick, received)
        acceleration, messages = self._network(self._perception.observe(memory, tick, own))
        memory, broadcasts = self._perception.send(memory, tick, own, messages)
        return Step(memory, acceleration, broadcasts=broadcasts, refused=refused)
