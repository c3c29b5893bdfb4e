"""Averager: collects the models of a round and makes one of them, on whatever node averages.

Sums go by ascending UAV, so that the order of arrival leaves no trace.
"""

import numpy as np
from numpy.typing import NDArray

from meanflock.federation.rules.base import Aggregator, State
from meanflock.federation.rules.fedavg import mean
from meanflock.federation.schedule import Schedule
from meanflock.federation.topology.base import Hop
from meanflock.swarm import plugins
from meanflock.swarm.declared import MAX_MEMORY_BYTES
from meanflock.swarm.errors import BadInput
from meanflock.swarm.plugins.failures import FAILURES, last_line
from meanflock.swarm.plugins.guard import as_floats, check_finite, check_memory, check_pair, check_same_form
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats
from meanflock.swarm.wire.control import encode_record
from meanflock.swarm.wire.messages import Frames

ABSURD = 1e9  # no weight of a learner that still learns: features are of order one, and so are the costs


class RuleFailed(Exception):
    """An aggregation rule raised, or returned what cannot be broadcast; the text names the rule and the round."""


class Averager:
    """The mail of the UAVs that average for one hop, by round.

    Attributes:
        hop: the hop.
        rule: the scenario's aggregation rule with its state; None where the hop takes the mean.
    """

    def __init__(self, hop: Hop, schedule: Schedule, scenario: Scenario) -> None:
        """Raises BadInput where the aggregation rule cannot begin."""
        self.hop, self._schedule = hop, schedule
        self._mail: dict[tuple[int, int], dict[int, tuple[Floats, float]]] = {}  # by round and averaging UAV
        self.rule = Rule(scenario) if hop.ruled else None

    def collect(self, frames: Frames) -> None:
        """Stores mail of this averager's hop; a second model of the same UAV changes nothing."""
        assert self.hop.mail is not None
        assert frames.links is not None
        models, weights = self.hop.mail.coding.read(frames.payload)
        for row, uav in frames.links.tolist():
            of_round = self._mail.setdefault((frames.round, uav), {})
            of_round.setdefault(int(frames.source[row]), (models[row], float(weights[row])))

    def average(self, number: int, uav: int) -> tuple[Floats | None, float, list[int]]:
        """The average at one UAV in a round.

        Returns:
            The model (L,), or None where nothing can be averaged: no mail, or in the last hop none but the UAV's own.
            The number of models behind it. The UAVs whose models cannot be averaged, ascending.

        Raises:
            RuleFailed: the aggregation rule failed.
        """
        mail, refused = usable(self._mail.get((number, uav), {}))
        if not mail or (self.hop.is_last and not self._is_shared(number, uav, mail)):
            return None, 0.0, refused
        uavs = np.array(sorted(mail), dtype=np.intp)
        models = np.stack([mail[sender][0] for sender in uavs.tolist()])
        weights = np.array([mail[sender][1] for sender in uavs.tolist()])
        if self.rule is not None:
            return self.rule.step(models, uavs, number), float(weights.sum()), refused
        return mean(models, weights), float(weights.sum()), refused

    def close(self, number: int) -> None:
        """Forgets the mail of a round and of all before it."""
        self._mail = {key: mail for key, mail in self._mail.items() if key[0] > number}

    def _is_shared(self, number: int, uav: int, mail: dict[int, tuple[Floats, float]]) -> bool:
        """Whether the mail at a UAV holds the model of another UAV."""
        if mail.keys() - {uav}:
            return True
        return mail[uav][1] > float(uav in self._schedule.participants(number))


class Rule:
    """An aggregation rule and its state. A plug-in: what it returns is validated here."""

    def __init__(self, scenario: Scenario) -> None:
        """Raises BadInput where the rule is not installed, its options do not fit or `init` fails."""
        self._name, self._parameters = scenario.federation.aggregation, scenario.declared.parameters
        self._rule: Aggregator = plugins.create("aggregator", self._name, scenario.federation.options, scenario)
        try:
            self.state: State = self._rule.init(self._parameters)
            self.record = _record(self.state)
        except FAILURES as error:
            raise BadInput(f"aggregator {self._name!r} failed in `init`: {last_line(error)}") from error

    def step(self, models: Floats, uavs: NDArray[np.intp], number: int) -> Floats:
        """The global model (L,) of models (S, L); state and record are those after it.

        Raises:
            RuleFailed: the rule raised, or returned something else; its state is unchanged.
        """
        try:
            answer = self._rule.step(self.state, models, uavs, number)
            after, returned = check_pair("step", answer, "the state and the model")
            model = as_floats("the model", returned, (self._parameters,))
            check_finite("the model", model)
            check_same_form("state", after, self.state)
            self.record = _record(after)
        except FAILURES as error:
            raise RuleFailed(f"aggregator {self._name!r} failed in round {number}: {last_line(error)}") from error
        self.state = after
        return model


def usable(mail: dict[int, tuple[Floats, float]]) -> tuple[dict[int, tuple[Floats, float]], list[int]]:
    """The mail that can be averaged at all, and the UAVs, ascending, whose models are not finite or absurdly large."""
    if not mail:
        return mail, []
    with np.errstate(invalid="ignore"):
        if (np.abs(np.concatenate([model for model, _ in mail.values()])) < ABSURD).all():  # NaN is below nothing
            return mail, []
        bad = sorted(uav for uav, (model, _) in mail.items() if not (np.abs(model) < ABSURD).all())
    return {uav: entry for uav, entry in mail.items() if uav not in bad}, bad


def _record(state: State) -> bytes:
    """The state of a rule as a record; empty where it has none.

    Raises:
        TypeError, ValueError: a checkpoint cannot hold it.
    """
    check_memory("state", state)
    for name, array in state.items():
        check_finite(f"state[{name!r}]", array)
    if (size := sum(array.nbytes for array in state.values())) > MAX_MEMORY_BYTES:
        raise ValueError(f"the state has {size} bytes; at most {MAX_MEMORY_BYTES}")
    return encode_record(state) if state else b""
