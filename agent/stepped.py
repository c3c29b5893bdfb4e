"""Controller that is commanded from outside, tick by tick: `mf.Stepped` takes the place of its own."""

from collections.abc import Sequence
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from meanflock.agent.controllers import base
from meanflock.agent.controllers.base import Broadcast, Controller, Memory, Received, Rows, Step
from meanflock.swarm.declared import MAX_BROADCAST_NUMBERS, MAX_PARAMETERS
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats, States, Vectors


class Command(msgspec.Struct, frozen=True, eq=False):
    """The command of a tick for all UAVs.

    acceleration: (N, 2), m/s². broadcasts: the frames to send. models: (N, W), the models after the tick; None: as they
    are.
    """

    acceleration: Vectors
    broadcasts: Sequence[Broadcast] = ()
    models: Floats | None = None


class External(Controller):
    """Controller that returns the command it was given. Its model is shared if it has `parameters`."""

    name = "stepped"
    dimensions = (2, 3)

    class Options(base.Options, frozen=True):
        """The options of `stepped`: what another controller declares."""

        parameters: Annotated[int, Meta(ge=0, le=MAX_PARAMETERS, description="size of the shared model")] = 0
        broadcast_numbers: Annotated[
            int, Meta(ge=0, le=MAX_BROADCAST_NUMBERS, description="most numbers that a UAV broadcasts in a tick")
        ] = 64
        shares: Annotated[bool, Meta(description="whether states are broadcast by `[sharing]`")] = False

    def __init__(self, options: Any, scenario: Scenario) -> None:
        super().__init__(options, scenario)
        self.parameters = options.parameters
        self.broadcast_numbers = options.broadcast_numbers
        self.shares = options.shares
        self.command: Command | None = None

    def init(self, uavs: NDArray[np.intp], plan: States) -> Memory:
        return {"uav": uavs.astype(np.int32), "model": np.zeros((len(uavs), self.parameters))}

    def step(self, memory: Memory, tick: int, own: States, received: Sequence[Received]) -> Step:
        command = self.command
        if command is None:
            raise RuntimeError("controller 'stepped' has no command; only mf.Stepped flies it")
        if command.models is not None:
            memory = memory | {"model": command.models[memory["uav"]]}
        broadcasts = command.broadcasts
        if broadcasts and len(own) < len(command.acceleration):  # after an error of a filter, each row alone
            broadcasts = [_part(broadcast, memory["uav"]) for broadcast in broadcasts]
        return Step(memory, command.acceleration[memory["uav"]], broadcasts=broadcasts)

    def get(self, memory: Memory) -> Floats:
        return memory["model"]

    def set(self, memory: Memory, rows: Rows, models: Floats) -> Memory:
        after = memory["model"].copy()
        after[rows] = models
        return memory | {"model": after}


def refuse_groups(scenario: Scenario, what: str) -> None:
    """Raises BadInput if a flight whose UAVs are all commanded from outside has groups."""
    if scenario.groups:
        raise BadInput(f"{what} commands all UAVs alike, and the scenario has `[[groups]]`; take one without them")


def _part(broadcast: Broadcast, uavs: NDArray[np.integer]) -> Broadcast:
    """The frames that some UAVs send; their rows are the positions in `uavs`."""
    senders = np.arange(len(broadcast.payload)) if broadcast.rows is None else broadcast.rows
    sent = np.isin(senders, uavs)
    return Broadcast(broadcast.payload[sent], np.searchsorted(uavs, senders[sent]))
