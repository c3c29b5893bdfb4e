"""The aggregation rule of a flight: a plug-in, whose answers are validated here."""

import math

from meanflock.federation.cut import share_delivered
from meanflock.federation.plan import Plan
from meanflock.federation.rules.base import Aggregate, Aggregator, State, Uploads
from meanflock.swarm import plugins
from meanflock.swarm.declared import MAX_STATE_BYTES
from meanflock.swarm.errors import FAILURES, BadInput, last_line
from meanflock.swarm.plugins.guard import as_floats, check_finite, check_memory, check_same_form, check_values
from meanflock.swarm.state import Floats


class RuleFailed(Exception):
    """An aggregation rule raised, or returned what cannot be broadcast; the text names the rule and the round."""


class Rule:
    """An aggregation rule.

    Attributes:
        asked_void: whether it is asked in rounds without models, too. state_bytes: most bytes of states of any
            length. resumable: whether its state is all in what it returns; else it is done when it fails.
    """

    def __init__(self, plan: Plan) -> None:
        """Raises BadInput where the rule is not installed, or its options do not fit."""
        federation, self._parameters = plan.scenario.federation, plan.declared.parameters
        self._name = federation.aggregation
        self._rule: Aggregator = plugins.create("aggregator", self._name, federation.options, plan.scenario)
        self.asked_void = bool(self._rule.asked_void)
        self.state_bytes = int(self._rule.state_bytes)
        self.resumable = bool(self._rule.resumable)

    def check_radio(self, plan: Plan) -> None:
        """Validates that the radio delivers as many whole models in a round as the rule needs.

        Raises:
            BadInput: it does not, and the text says what to change.
        """
        upload = next((hop.codec for hop in plan.hops if hop.averages == "nothing"), None)
        if upload is None or upload.count == 1 or not self._rule.complete:
            return
        share = share_delivered(plan.scenario, upload.bits)
        expected = plan.scenario.participants * (1.0 - (1.0 - share) ** (1 + plan.scenario.federation.retries)) ** (
            upload.count
        )
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

    def step(self, state: State, uploads: Uploads) -> tuple[State, Aggregate]:
        """The state after a round, and what is broadcast; without a model where the rule waits for more.

        Raises:
            RuleFailed: the rule raised, or returned something else.
        """
        try:
            answer = self._rule.step(state, uploads)
            after, returned = check_values("step", answer, 2, "the state and the model")
            aggregate = returned if isinstance(returned, Aggregate) else Aggregate(returned)
            if aggregate.model is not None:
                model = as_floats("the model", aggregate.model, (self._parameters,))
                check_finite("the model", model)
                aggregate = aggregate._replace(model=model)
            if not isinstance(aggregate.note, bytes) or len(aggregate.note) > self._rule.note_bytes:
                raise ValueError(f"a note of {len(aggregate.note)} bytes; `note_bytes` is {self._rule.note_bytes}")
            metrics = {str(name): float(number) for name, number in aggregate.metrics.items()}
            if not all(map(math.isfinite, metrics.values())):
                raise ValueError(f"metrics that are not finite: {metrics}")
            aggregate = aggregate._replace(metrics=metrics)
            self._check_form(after, state)
            _check_finite(after)
        except FAILURES as error:
            raise self._failed(uploads, error) from error
        return after, aggregate

    def weights(self, uploads: Uploads) -> Floats | None:
        """The weight of each model (S,), greater than 0; None where the rule is no weighted mean.

        Raises:
            RuleFailed: the rule raised, or returned something else.
        """
        try:
            returned = self._rule.weights(uploads)
            if returned is None:
                return None
            weights = as_floats("`weights`", returned, (len(uploads.uavs),))
            check_finite("`weights`", weights)
            if not (weights > 0.0).all():
                raise ValueError(f"`weights` has {weights.min()}; each must be greater than 0")
        except FAILURES as error:
            raise self._failed(uploads, error) from error
        return weights

    def _check_form(self, after: State, before: State) -> None:
        """Check that a state has the form of the one before, but for the lengths of arrays of bytes."""
        if not self._rule.state_bytes or not isinstance(after, dict):
            check_same_form("state", after, before)
            return
        check_memory("state", after)
        texts = {name for name, array in after.items() if array.dtype == "u1" and array.ndim == 1}
        alike = {name: before.get(name, array) if name in texts else array for name, array in after.items()}
        check_same_form("state", alike, before)
        if (size := sum(after[name].nbytes for name in texts)) > self._rule.state_bytes:
            raise ValueError(f"the state has {size} bytes; `state_bytes` is {self._rule.state_bytes}")

    def _failed(self, uploads: Uploads, error: BaseException) -> RuleFailed:
        return RuleFailed(f"aggregator {self._name!r} failed in round {uploads.round}: {last_line(error)}")


def _check_finite(state: State) -> None:
    for name, array in state.items():
        check_finite(f"state[{name!r}]", array)
