"""How long a message to the world may be: as long as the scenario and its plug-ins let an honest one become."""

from collections.abc import Callable
from typing import Any

import numpy as np

from meanflock.swarm import plugins, state
from meanflock.swarm.declared import MAX_BROADCASTS, controller
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire import control
from meanflock.worldsim.formation import initial_states

_OVERHEAD_BYTES = 1024
_FRAME_BYTES = 64  # of a batch, around its numbers
_NUMBER_BYTES = 8


class Limits:
    """The longest Acts of a scenario. What a controller remembers is measured on one UAV, for all have arrays alike."""

    def __init__(self, scenario: Scenario) -> None:
        """Raises BadInput where the controller or the aggregation rule cannot begin."""
        declared, federation, uavs = scenario.declared, scenario.federation, scenario.uavs
        flying = controller(scenario)
        rule = plugins.create("aggregator", federation.aggregation, federation.options, scenario)
        plan = initial_states(scenario)
        memory = _recorded(
            f"controller {scenario.method!r}", "memory", lambda: flying.init(np.arange(1), plan), " with UAV 0"
        )
        kept = _recorded(f"aggregator {federation.aggregation!r}", "state", lambda: rule.init(declared.parameters))
        numbers = state.AXES + len(declared.diagnostics) + declared.weights + declared.broadcast_numbers
        numbers += 2 * declared.parameters + MAX_BROADCASTS  # an upload and what rounding took from it; names
        self._row = _NUMBER_BYTES * numbers + memory
        self._fixed = _OVERHEAD_BYTES + _FRAME_BYTES * MAX_BROADCASTS + 8 * uavs  # and the UAVs it refuses or loses
        self._leader = _NUMBER_BYTES * declared.parameters + kept

    def act(self, rows: int) -> int:
        """The most bytes of an Act of a node with so many UAVs; of the leader, with none."""
        return self._fixed + (self._row * rows if rows else self._leader)


def _recorded(who: str, what: str, init: Callable[[], Any], whose: str = "") -> int:
    """Bytes of what a plug-in remembers before it begins: its memory or state, `what`.

    Raises:
        BadInput: its `init` failed, or returns what cannot be kept.
    """
    try:
        begun = init()
        if not isinstance(begun, dict):
            raise TypeError(f"the {what} is a {type(begun).__name__}; expected a dict of arrays")
        for name, array in begun.items():
            if not isinstance(array, np.ndarray) or array.dtype not in control.TRAVELS:
                raise TypeError(f"{what}[{name!r}] is no array of numbers that can be kept in a checkpoint")
        return len(control.encode_record(begun))
    except Exception as error:
        raise BadInput(f"{who} failed in `init`{whose}: {plugins.last_line(error)}") from error
