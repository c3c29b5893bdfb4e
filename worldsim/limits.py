"""How long a message to the world may be: as long as the scenario and its plug-ins let an honest one become."""

from collections.abc import Callable
from typing import Any

import numpy as np

from meanflock.swarm import mission, plugins, state
from meanflock.swarm.declared import MAX_BROADCASTS, controller
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire import control

_OVERHEAD_BYTES = 1024
_FRAME_BYTES = 64  # of a batch, around its numbers
_NUMBER_BYTES = 8


class Limits:
    """The longest Acts of a scenario. What a controller remembers is measured on one UAV, for all have arrays alike."""

    def __init__(self, scenario: Scenario) -> None:
        """Raises BadInput where the controller or the aggregation rule cannot begin."""
        declared, federation, uavs = scenario.declared, scenario.federation, scenario.uavs
        flyer = controller(scenario)
        memory = _record(
            f"controller {scenario.method!r} failed in `init` with UAV 0",
            lambda: _begun(flyer, scenario),
        )
        rule = plugins.create("aggregator", federation.aggregation, federation.options, scenario)
        state_of_rule = _record(
            f"aggregator {federation.aggregation!r} failed in `init`", lambda: rule.init(declared.parameters)
        )
        numbers = state.AXES + len(declared.diagnostics) + declared.weights + declared.broadcast_numbers
        numbers += 2 * declared.parameters + MAX_BROADCASTS  # an upload and what rounding took from it; names
        self._row = _NUMBER_BYTES * numbers + len(memory)
        self._fixed = _OVERHEAD_BYTES + _FRAME_BYTES * MAX_BROADCASTS + 8 * uavs  # and the UAVs it refuses or loses
        self._leader = _NUMBER_BYTES * declared.parameters + len(state_of_rule)

    def act(self, rows: int) -> int:
        """The most bytes of an Act of a node with so many UAVs; of the leader, with none."""
        return self._fixed + (self._row * rows if rows else self._leader)


def _begun(flyer: Any, scenario: Scenario) -> dict[str, Any]:
    """What a controller remembers of UAV 0 at first; BadInput where its model is not of the size it declares."""
    memory: dict[str, Any] = flyer.init(np.arange(1), mission.starts(scenario))
    wanted = (1, scenario.declared.parameters)
    one_row = isinstance(memory, dict) and all(
        np.shape(array)[:1] == (1,) for array in memory.values()
    )  # else: its agent
    if wanted[1] and one_row and (shape := np.shape(flyer.get(memory))) != wanted:
        raise BadInput(f"controller {scenario.method!r}: `get` returns shape {shape}; expected {wanted}")
    return memory


def _record(failure: str, begin: Callable[[], dict[str, Any]]) -> bytes:
    """What a plug-in remembers at first, as a record; BadInput where it cannot begin, or that cannot be kept."""
    try:
        memory = begin()
    except BadInput:
        raise
    except Exception as error:
        raise BadInput(f"{failure}: {plugins.last_line(error)}") from error
    try:
        return control.encode_record(memory)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise BadInput(f"{failure}: it remembers what is no array of numbers: {error}") from error
