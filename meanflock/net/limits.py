"""Limits of the length of messages to the world, from the scenario and the declarations of its plug-ins."""

from functools import lru_cache

import numpy as np

from meanflock.agent.controllers.base import Arrival
from meanflock.agent.learning.surroundings import check_rule
from meanflock.federation.groups import Group
from meanflock.federation.plan import Plan
from meanflock.federation.rule import Rule
from meanflock.net import keys
from meanflock.net.bus import Quota
from meanflock.net.members import LEADER
from meanflock.swarm import mission
from meanflock.swarm.declared import MAX_BROADCASTS, NO_LEARNER, controller
from meanflock.swarm.errors import FAILURES, BadInput, MessageRejected, last_line
from meanflock.swarm.plugins.guard import check_memory, check_same_form
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire import control

JOIN_BYTES, RECEIVED_BYTES = 256, 64
_NO_NODE = Quota("", 0)  # of keys that belong to no node
_OVERHEAD_BYTES = 1024
_FRAME_BYTES = 64  # of a batch, around its numbers
_NUMBER_BYTES = 8


class Limits:
    """Longest Acts of a flight. The memory of a controller is measured on one UAV, because all UAVs have arrays
    alike.
    """

    def __init__(self, plan: Plan) -> None:
        """Raises BadInput if a coding fails, or `init` of the controller or of the rule does; if the radio delivers
        too few whole models for the rule, or the rule may not fly beside a learner."""
        declared, uavs = plan.declared, plan.scenario.uavs
        for codec in dict.fromkeys(hop.codec for hop in plan.hops):
            codec.try_out()
        memory = max(len(_initial_memory(group)) for group in plan.groups)
        rule = Rule(plan)
        rule.check_radio(plan)
        if any(group.takes_part and group.scenario.training.learner != NO_LEARNER for group in plan.groups):
            check_rule(plan.scenario, declared.parameters)
        state_of_rule = control.encode_record(rule.begin())
        numbers = plan.scenario.dimensions + len(declared.diagnostics) + declared.weights + declared.broadcast_numbers
        numbers += declared.parameters + MAX_BROADCASTS  # residuals of the coding; names
        numbers += sum(
            hop.codec.count * (hop.codec.width + 1) for hop in plan.hops if hop.role == "agent" and not hop.is_local
        )
        self._row = _NUMBER_BYTES * numbers + memory
        if plan.scenario.federation.upload_threshold or plan.scenario.federation.share < 1.0:
            self._row += _NUMBER_BYTES * declared.parameters + _FRAME_BYTES  # the model of the last upload
        if any(hop.is_local for hop in plan.hops):  # a UAV that averages stores its model and a state of the rule
            self._row += _NUMBER_BYTES * (declared.parameters + 1) + len(state_of_rule) + _FRAME_BYTES
        last = plan.hops[-1].codec if plan.hops else None
        if last is not None and last.count > 1:  # the global model, its head, and its fragments that were received
            self._row += (_NUMBER_BYTES * last.size + 2) * last.count + last.form.head + 2 * _FRAME_BYTES
        self._fixed = _OVERHEAD_BYTES + _FRAME_BYTES * MAX_BROADCASTS + 16 * uavs  # 16: numbers of UAVs in four lists
        self._leader = len(state_of_rule) + rule.state_bytes
        if last is not None:
            self._leader += last.count * (last.dtype.itemsize * last.width + _NUMBER_BYTES)

    def act(self, rows: int) -> int:
        """Most bytes of an Act of a node with so many UAVs; 0 for the leader."""
        return self._fixed + (self._row * rows if rows else self._leader)


def _initial_memory(group: Group) -> bytes:
    """Initial memory of the controller for the first UAV of a group, as a record.

    Raises:
        BadInput: `init` fails, or a checkpoint cannot store the memory; the model has another size than declared; or
            the controller cannot take a model or a goal.
    """
    scenario, wanted, first = group.scenario, (1, group.declared.parameters), group.uavs[:1]
    flyer, row = controller(scenario), np.arange(1)
    starts = mission.starts(scenario).astype(control.FLOAT_OF_BITS[scenario.radio.bits_per_float])
    method = "init"
    try:
        memory = flyer.init(first.copy(), starts.astype(np.float64))  # as agents receive it
        check_memory("memory", memory)
        # The agent reports a memory of another form.
        has_row = all(array.shape[:1] == (1,) for array in memory.values())
        if wanted[1] and has_row:
            method = "get"
            model = flyer.get(memory)
            if (shape := np.shape(model)) != wanted:
                raise BadInput(f"controller {scenario.method!r}: `get` returns shape {shape}; expected {wanted}")
            method = "set"
            arrival = Arrival(1, np.array(model, dtype=np.float64), np.ones(1, dtype=bool), [b""])
            check_same_form("memory", flyer.arrived(memory, row, arrival), memory)
        if scenario.is_guided and has_row:
            method = "guide"
            check_same_form("memory", flyer.guide(memory, row, mission.goals(scenario)[first]), memory)
        return control.encode_record(memory)
    except BadInput:
        raise
    except FAILURES as error:
        text = f"controller {scenario.method!r} failed in `{method}` with UAV {first[0]}: {last_line(error)}"
        raise BadInput(text) from error


class Quotas:
    """Quota of every key that the world listens on; may be called from any thread."""

    def __init__(self, run: str, scenario: Scenario, limits: Limits, rows_at_most: int | None = None) -> None:
        """`rows_at_most`: UAVs one agent may hold; None: as many as there are."""
        self._run = run
        rows = min(rows_at_most or scenario.uavs, scenario.uavs)
        self._agent = min(limits.act(rows), control.MAX_BYTES)
        self._leader = min(limits.act(0), control.MAX_BYTES)
        self.largest = max(self._agent, self._leader, JOIN_BYTES, RECEIVED_BYTES)  # of all, bytes
        self._cached = lru_cache(maxsize=4096)(self._quota)

    def __call__(self, key: str) -> Quota:
        """The sender of the messages under `key`, and the most bytes of one of them."""
        return self._cached(key)

    def _quota(self, key: str) -> Quota:
        if key == keys.received(self._run):
            return Quota(key, RECEIVED_BYTES)
        if key in (keys.telemetry(self._run), keys.observed(self._run)):
            return Quota(key, 0)
        try:
            name = keys.node_of(key).partition(".")[0]  # nodes that succeed each other in a place share its quota
        except MessageRejected:
            return _NO_NODE
        if key.endswith("/join"):
            return Quota(f"{name} joining", JOIN_BYTES)
        if not key.endswith("/act"):
            return Quota(name, 0)
        return Quota(name, self._leader if name == LEADER else self._agent)
