"""Averager: collects the models of a round and makes one of them, on whatever node averages.

Sums go by ascending UAV, so that the order of arrival leaves no trace.
"""

import inspect

import numpy as np

from meanflock.federation.rules.base import Aggregator, State, Uploads
from meanflock.federation.rules.fedavg import mean
from meanflock.federation.schedule import Schedule
from meanflock.federation.topology.base import Hop
from meanflock.swarm import plugins
from meanflock.swarm.declared import MAX_MEMORY_BYTES
from meanflock.swarm.errors import FAILURES, BadInput, last_line
from meanflock.swarm.plugins.guard import as_floats, check_finite, check_memory, check_pair, check_same_form
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats, Mask
from meanflock.swarm.wire.control import encode_record
from meanflock.swarm.wire.messages import Frames

ABSURD = 1e9  # no weight of a learner that still learns: features are of order one, and so are the costs


class RuleFailed(Exception):
    """An aggregation rule raised, or returned what cannot be broadcast; the text names the rule and the round."""


class Averager:
    """The mail of the UAVs that average for one hop, by round.

    Attributes:
        hop: the hop.
    """

    def __init__(self, hop: Hop, schedule: Schedule, scenario: Scenario) -> None:
        """Raises BadInput where the aggregation rule cannot begin."""
        self.hop, self._schedule = hop, schedule
        self._mail: dict[tuple[int, int], dict[int, tuple[Floats, float]]] = {}  # by round and averaging UAV
        self._takes_late = scenario.federation.deadline is not None
        self._rule = Rule(scenario) if hop.ruled else None
        self._state: State = {} if self._rule is None else self._rule.begin()

    @property
    def record(self) -> bytes:
        """The state of the aggregation rule, a record; empty where it has none."""
        return encode_record(self._state) if self._state else b""

    def take_over(self, state: State) -> None:
        """Goes on with the state of the aggregation rule that another node left."""
        self._state = state

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
        given, sent = self._due(number, uav)
        mail, refused = usable(given)
        if not mail or (self.hop.is_last and not self._is_shared(number, uav, mail)):
            return None, 0.0, refused
        uavs = np.array(sorted(mail), dtype=np.intp)
        models = np.stack([mail[sender][0] for sender in uavs.tolist()])
        weights = np.array([mail[sender][1] for sender in uavs.tolist()])
        if self._rule is not None:
            uploads = Uploads(models, uavs, np.array([sent[sender] for sender in uavs.tolist()]), number)
            self._state, model = self._rule.step(self._state, uploads)
            return model, float(weights.sum()), refused
        return mean(models, weights), float(weights.sum()), refused

    def _due(self, number: int, uav: int) -> tuple[dict[int, tuple[Floats, float]], dict[int, int]]:
        """The mail of a UAV in a round, and the rounds in which it was sent, by sender.

        Where there is a deadline, mail of earlier rounds that came after theirs was averaged is part of it; of several
        models of a sender the latest counts.
        """
        mail: dict[int, tuple[Floats, float]] = {}
        sent: dict[int, int] = {}
        for of_round in range(number - 1 if self._takes_late else number, number + 1):
            found = self._mail.get((of_round, uav), {})
            mail |= found
            sent |= dict.fromkeys(found, of_round)
        return mail, sent

    def close(self, number: int) -> None:
        """Forgets the mail of a round and of all before it."""
        self._mail = {key: mail for key, mail in self._mail.items() if key[0] > number}

    def _is_shared(self, number: int, uav: int, mail: dict[int, tuple[Floats, float]]) -> bool:
        """Whether the mail at a UAV holds the model of another UAV."""
        if mail.keys() - {uav}:
            return True
        return mail[uav][1] > float(uav in self._schedule.participants(number))


class Rule:
    """An aggregation rule. A plug-in: what it returns is validated here."""

    def __init__(self, scenario: Scenario) -> None:
        """Raises BadInput where the rule is not installed, its options do not fit or its `step` is of another form."""
        self._name, self._parameters = scenario.federation.aggregation, scenario.declared.parameters
        self._rule: Aggregator = plugins.create("aggregator", self._name, scenario.federation.options, scenario)
        takes = inspect.signature(self._rule.step)
        try:
            takes.bind("state", "uploads")
        except TypeError:
            raise BadInput(
                f"aggregator {self._name!r}: `step` takes {takes}; write step(self, state, uploads), with "
                "uploads.models, uploads.uavs and uploads.round"
            ) from None

    def begin(self) -> State:
        """The state before the first round.

        Raises:
            BadInput: `init` fails, or a checkpoint cannot hold what it returns.
        """
        try:
            state: State = self._rule.init(self._parameters)
            _check_state(state)
        except FAILURES as error:
            raise BadInput(f"aggregator {self._name!r} failed in `init`: {last_line(error)}") from error
        return state

    def step(self, state: State, uploads: Uploads) -> tuple[State, Floats | None]:
        """The state after a round, and its global model (L,); None where the rule waits for more models.

        Raises:
            RuleFailed: the rule raised, or returned something else.
        """
        try:
            answer = self._rule.step(state, uploads)
            after, returned = check_pair("step", answer, "the state and the model")
            model = None if returned is None else as_floats("the model", returned, (self._parameters,))
            if model is not None:
                check_finite("the model", model)
            check_same_form("state", after, state)
            _check_state(after)
        except FAILURES as error:
            raise self._failed(uploads, error) from error
        return after, model

    def weights(self, uploads: Uploads) -> Floats | None:
        """The weight of each model (S,), greater than 0; None where the rule is no weighted mean.

        Raises:
            RuleFailed: the rule raised, or returned something else.
        """
        try:
            returned = self._rule.weights(uploads)
            if returned is None:
                return None
            weights = as_floats("`weights`", returned, (len(uploads.models),))
            check_finite("`weights`", weights)
            if not (weights > 0.0).all():
                raise ValueError(f"`weights` has {weights.min()}; each must be greater than 0")
        except FAILURES as error:
            raise self._failed(uploads, error) from error
        return weights

    def _failed(self, uploads: Uploads, error: BaseException) -> RuleFailed:
        return RuleFailed(f"aggregator {self._name!r} failed in round {uploads.round}: {last_line(error)}")


def usable(mail: dict[int, tuple[Floats, float]]) -> tuple[dict[int, tuple[Floats, float]], list[int]]:
    """The mail that can be averaged at all, and the UAVs, ascending, whose models are not finite or absurdly large."""
    if not mail:
        return mail, []
    sound = is_usable(np.stack([model for model, _ in mail.values()]))
    if sound.all():
        return mail, []
    bad = sorted(uav for uav, is_sound in zip(mail, sound.tolist(), strict=True) if not is_sound)
    return {uav: entry for uav, entry in mail.items() if uav not in bad}, bad


def is_usable(models: Floats) -> Mask:
    """Which models (S, L) can be averaged, (S,): those that are finite and not absurdly large."""
    with np.errstate(invalid="ignore"):
        return np.asarray((np.abs(models) < ABSURD).all(axis=-1))  # NaN is below nothing


def _check_state(state: State) -> None:
    """Validates the state of a rule.

    Raises:
        TypeError, ValueError: a checkpoint cannot hold it.
    """
    check_memory("state", state)
    for name, array in state.items():
        check_finite(f"state[{name!r}]", array)
    if (size := sum(array.nbytes for array in state.values())) > MAX_MEMORY_BYTES:
        raise ValueError(f"the state has {size} bytes; at most {MAX_MEMORY_BYTES}")
