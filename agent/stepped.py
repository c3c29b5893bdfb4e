"""An agent node that is commanded from outside, tick by tick: `mf.Stepped` takes the place of a controller."""

from collections.abc import Sequence
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from meanflock.agent.controllers import base
from meanflock.agent.controllers.base import Broadcast, Controller, Memory, Received, Rows, Step
from meanflock.agent.controllers.filtered import Filter, of_inner
from meanflock.agent.guarded import choose
from meanflock.agent.node import Agent
from meanflock.swarm.declared import MAX_BROADCAST_NUMBERS, MAX_PARAMETERS
from meanflock.swarm.net.client import NodeClient
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats, Plane, States
from meanflock.swarm.wire import tick as wire
from meanflock.swarm.wire.messages import Sense, Welcome


class Command(msgspec.Struct, frozen=True, eq=False):
    """The command of a tick for all UAVs.

    acceleration: (N, 2), m/s². broadcasts: the frames to send. models: (N, W), the models after the tick; None: as they
    are.
    """

    acceleration: Plane
    broadcasts: Sequence[Broadcast] = ()
    models: Floats | None = None


class External(Controller):
    """Controller that returns the command it was given. Its model is shared if it has `parameters`."""

    name = "stepped"

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


def _part(broadcast: Broadcast, uavs: NDArray[np.integer]) -> Broadcast:
    """The frames that some UAVs send; their rows are the positions in `uavs`."""
    senders = np.arange(len(broadcast.payload)) if broadcast.rows is None else broadcast.rows
    sent = np.isin(senders, uavs)
    return Broadcast(broadcast.payload[sent], np.searchsorted(uavs, senders[sent]))


class SteppedAgent(Agent):
    """Agent of all UAVs that receives when it is asked, and acts when it is commanded.

    received: the frames that reached the UAVs, without those of a filter.
    """

    def __init__(self, welcome: Welcome) -> None:
        super().__init__(welcome)
        controller = self._controller.controller
        external = controller.inner if isinstance(controller, Filter) else controller
        assert isinstance(external, External)
        self._filtered = controller is not external
        self._external = external
        self._frames: tuple[Received, ...] = ()
        self.received: tuple[Received, ...] = ()

    def prepare(self, sense: Sense) -> None:
        """Receive the frames of a request; `act` uses them."""
        before = self._memory
        self._frames = super()._begin(sense)
        if self._controller.asleep is not None:
            self._memory = choose(self._controller.asleep, before, self._memory)
        self.received = of_inner(self._frames) if self._filtered else self._frames

    def command(self, command: Command) -> None:
        """Set what the UAVs do in the tick that is asked for."""
        self._external.command = command

    def _begin(self, sense: Sense) -> tuple[Received, ...]:
        return self._frames  # `prepare` has begun the tick


class SteppedClient(NodeClient):
    """Client of a `SteppedAgent`. It holds a request until the node is commanded."""

    _node: SteppedAgent
    _held: tuple[str, bytes] | None = None
    states: States

    def command(self, command: Command) -> None:
        """Reply to the request, if there is one: a swarm whose UAVs are all paused or lost is not asked."""
        if self._held is not None:
            key, raw = self._held
            self._held = None
            self._node.command(command)
            super()._at_once(key, raw)

    @property
    def is_asked(self) -> bool:
        """Says whether a request waits for a command."""
        return self._held is not None

    @property
    def received(self) -> tuple[Received, ...]:
        """The frames that reached the UAVs with the request; none without a request."""
        return self._node.received if self._held is not None else ()

    @property
    def models(self) -> Floats:
        """The models of the UAVs, (N, W), global ones that arrived with the request included."""
        return self._node.models

    def _at_once(self, key: str, raw: bytes) -> bool:
        if raw[1:2] not in wire.TYPES:
            return super()._at_once(key, raw)
        sense = wire.read_sense(raw, self._blank.copy())
        self._node.prepare(sense)
        self.states = sense.states
        self._held = key, raw
        return True
