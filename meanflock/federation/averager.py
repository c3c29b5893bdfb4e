"""Averager: collects the models of a round and makes one of them, on whatever node averages.

Sums go by ascending UAV, so that the order of arrival leaves no trace.
"""

import inspect

import numpy as np
from numpy.typing import NDArray

from meanflock.federation.fragments import share_delivered
from meanflock.federation.mail import Collector, Joined
from meanflock.federation.plan import Plan
from meanflock.federation.rules.base import Aggregator, State, Uploads, mean
from meanflock.federation.schedule import Schedule
from meanflock.federation.topology.base import Hop
from meanflock.swarm import plugins
from meanflock.swarm.declared import MAX_STATE_BYTES
from meanflock.swarm.errors import FAILURES, BadInput, last_line
from meanflock.swarm.plugins.guard import as_floats, check_finite, check_memory, check_same_form, check_values
from meanflock.swarm.state import Floats
from meanflock.swarm.wire.control import encode_record


class RuleFailed(Exception):
    """An aggregation rule raised, or returned what cannot be broadcast; the text names the rule and the round."""


class Averager(Collector):
    """The mail of the UAVs that average for one hop, and the state of the aggregation rule there."""

    def __init__(self, hop: Hop, schedule: Schedule, plan: Plan, uavs: NDArray[np.intp]) -> None:
        """Raises BadInput where the aggregation rule cannot begin."""
        super().__init__(hop, plan.scenario, uavs)
        self._schedule = schedule
        self._rule = Rule(plan) if hop.ruled else None
        self._state: State = {} if self._rule is None else self._rule.begin()

    @property
    def record(self) -> bytes:
        """The state of the aggregation rule, a record; empty where it has none."""
        return encode_record(self._state) if self._state else b""

    def take_over(self, state: State) -> None:
        """Goes on with the state of the aggregation rule that another node left."""
        self._state = state

    def average(self, joined: Joined, number: int, uav: int) -> tuple[Floats | None, Floats, Floats]:
        """The average at one UAV in a round.

        Returns:
            The model (L,), or None where nothing can be averaged: no mail, or in the last hop none but the UAV's own.
            The sum of the weights of the models behind each fragment, (F,), and their number, (F,).

        Raises:
            RuleFailed: the aggregation rule failed.
        """
        uploads, counts, of_each = joined.to(int(self.uavs.searchsorted(uav)), number)
        weights = counts.sum(axis=0)
        behind = of_each.sum(axis=0)
        if not len(uploads.uavs) or (self.hop.is_last and not self._is_shared(number, uav, uploads, behind)):
            return None, weights, behind
        if self._rule is None:
            return mean(uploads.models, joined.by_weight(counts)), weights, behind
        self._state, model = self._rule.step(self._state, uploads)
        return model, weights, behind

    def _is_shared(self, number: int, uav: int, uploads: Uploads, behind: Floats) -> bool:
        """Returns whether the models at a UAV are not only its own."""
        if (uploads.uavs != uav).any():
            return True
        assert self.hop.mail is not None
        is_average = self.hop.mail.mail is not None
        return is_average and bool(behind.max() > float(uav in self._schedule.participants(number)))


class Rule:
    """An aggregation rule. A plug-in: what it returns is validated here."""

    def __init__(self, plan: Plan) -> None:
        """Raises BadInput where the rule is not installed, its options do not fit or its `step` is of another form."""
        federation, self._parameters = plan.scenario.federation, plan.declared.parameters
        self._name = federation.aggregation
        self._rule: Aggregator = plugins.create("aggregator", self._name, federation.options, plan.scenario)
        takes = inspect.signature(self._rule.step)
        try:
            takes.bind("state", "uploads")
        except TypeError:
            raise BadInput(
                f"aggregator {self._name!r}: `step` takes {takes}; write step(self, state, uploads), with "
                "uploads.models, uploads.uavs and uploads.round"
            ) from None

    def check_radio(self, plan: Plan) -> None:
        """Validates that the radio delivers as many whole models in a round as the rule needs.

        Raises:
            BadInput: it does not, and the text says what to change.
        """
        upload = next((hop.coding for hop in plan.hops if hop.mail is None), None)
        if upload is None or upload.fragments is None or not self._rule.complete:
            return
        share = share_delivered(plan.scenario, 8 * upload.fragments.width)
        expected = plan.scenario.participants * share**upload.count
        if expected < self._rule.complete:
            raise BadInput(
                f"`federation.aggregation` {self._name} needs {self._rule.complete} whole models in a round; of models "
                f"in {upload.count} fragments {expected:.2g} are expected; take fedavg or median, or a smaller model"
            )

    def begin(self) -> State:
        """The state before the first round.

        Raises:
            BadInput: `init` fails, or a checkpoint cannot hold what it returns.
        """
        try:
            state: State = self._rule.init(self._parameters)
            check_memory("state", state)
            _check_finite(state)
            if (size := sum(array.nbytes for array in state.values())) > MAX_STATE_BYTES:
                raise ValueError(f"the state has {size} bytes; at most {MAX_STATE_BYTES}")
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
            after, returned = check_values("step", answer, 2, "the state and the model")
            model = None if returned is None else as_floats("the model", returned, (self._parameters,))
            if model is not None:
                check_finite("the model", model)
            check_same_form("state", after, state)
            _check_finite(after)
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


def _check_finite(state: State) -> None:
    for name, array in state.items():
        check_finite(f"state[{name!r}]", array)
