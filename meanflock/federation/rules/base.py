"""Base class of aggregation rules, which compute the global model from the models of a round."""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from functools import cached_property
from types import MappingProxyType
from typing import Any, ClassVar, Literal, NamedTuple, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats

State: TypeAlias = dict[str, NDArray[Any]]


class Uploads:
    """The models of a round that one node averages, S of them, in ascending order of their UAVs.

    Models that are too long for one message arrive in fragments, and some may be lost.

    Attributes:
        models: (S, parameters), finite. A number that was lost is replaced by the mean of those that arrived from other
            UAVs, or by 0 if none arrived. So a rule that ignores `arrived` computes something sensible.
        uavs: (S,) the UAVs that the models are of.
        sent: (S,) the rounds in which they were sent; below `round` for an upload that came after its deadline.
        slots: (S,) slots that they were on the air, all fragments together; 0 for the model of the UAV that averages.
        samples: (S,) how much each model counts, as `Controller.samples` returns it, greater than 0; else 1.
        arrived: (S, parameters) whether each number of a model arrived.
        round: the number of the round, from 1 on.
        based: (S,) the round of the global model that each training began with, 0 for that of take-off, as
            `Controller.based` returns it; else, or where that was lost, `sent` − 1.
        notes: bytes that came with each model, as `Controller.note` returns them; empty where they were lost.
    """

    models: Floats
    uavs: NDArray[np.intp]
    sent: NDArray[np.integer]
    slots: NDArray[np.integer]
    samples: Floats
    arrived: NDArray[np.bool_]
    round: int
    based: NDArray[np.integer]
    notes: tuple[bytes, ...]

    def __init__(
        self,
        models: Floats,
        uavs: NDArray[np.intp],
        sent: NDArray[np.integer],
        slots: NDArray[np.integer],
        samples: Floats,
        arrived: NDArray[np.bool_],
        round: int,
        based: NDArray[np.integer] | None = None,
        notes: Sequence[bytes] | None = None,
    ) -> None:
        self.models, self.arrived = models, arrived
        self.uavs, self.sent, self.slots, self.samples, self.round = uavs, sent, slots, samples, round
        self.based = sent - 1 if based is None else based
        self.notes = (b"",) * len(uavs) if notes is None else tuple(notes)

    @cached_property
    def mean(self) -> Floats:
        """(parameters,) mean of each number over the models in which it arrived, all counted alike; 0 if in none."""
        return mean(self.models, None, self.arrived)

    @classmethod
    def complete(
        cls, models: Floats, number: int = 1, uavs: NDArray[np.intp] | None = None, samples: Floats | None = None
    ) -> "Uploads":
        """Uploads (S, parameters) that arrived whole and in time, in one slot each; of UAVs 0, 1 … unless named."""
        count = len(models)
        return cls(
            models,
            np.arange(count) if uavs is None else uavs,
            sent=np.full(count, number),
            slots=np.ones(count, dtype=np.intp),
            samples=np.ones(count) if samples is None else samples,
            arrived=np.ones(models.shape, dtype=bool),
            round=number,
        )


class Aggregate(NamedTuple):
    """What a rule makes of a round, if that is more than a model.

    model: (parameters,); None: nothing is broadcast. note: bytes that are broadcast with it, at most `note_bytes`.
    done: no round follows: UAVs upload nothing any more; only a leader can say so. metrics: finite numbers by name,
        recorded with the round.
    """

    model: Floats | None
    note: bytes = b""
    done: bool = False
    metrics: Mapping[str, float] = MappingProxyType({})


def mean(models: Floats, weights: Floats | None = None, arrived: NDArray[np.bool_] | None = None) -> Floats:
    """Mean of models `(S, L)`, added up in their order, `(L,)`, Eq. FL_AVG; 0 for no models.

    Args:
        models: the models.
        weights: (S,) or (S, L), what each counts; None: all the same.
        arrived: (S, L), weights of the models that count; None: all. The mean of none of them is 0.
    """
    counts_alike = weights is None or bool((weights == 1.0).all())
    weights = np.ones(len(models)) if weights is None else weights
    some = None if arrived is None or arrived.all() else arrived  # a mask is added up more slowly
    total = np.zeros(models.shape[1])
    for place, model in enumerate(models):
        share = model if counts_alike else weights[place] * model
        if some is None:
            total += share
        else:
            np.add(total, share, out=total, where=some[place])
    if not len(models):
        return total
    count: Floats | NDArray[np.int32]
    if some is None:
        count = np.add.accumulate(weights, axis=0)[-1]
    elif counts_alike:
        count = np.add.reduce(some.view(np.uint8), axis=0, dtype=np.int32)
    else:
        count = np.zeros(models.shape[1])
        for weight, here in zip(weights, some, strict=True):
            count += np.where(here, weight, 0.0)
    return total / np.where(count > 0, count, 1)


class Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base class of a rule's options: derive from it and add annotated fields with defaults."""


class Aggregator:
    """Base class of aggregation rules. Override `weights` if the rule is a weighted mean; else `step`, and `init` if it
    has a state.

    Models are in ascending order of their UAVs, so the order of arrival has no effect.
    """

    plugin_kind: ClassVar[Literal["aggregator"]] = "aggregator"
    name: ClassVar[str] = ""  # value of `federation.aggregation`
    Options: ClassVar[type[msgspec.Struct]] = Options
    complete: ClassVar[int] = 0  # uploads without a lost fragment that a round needs
    bears_silence: ClassVar[bool] = True  # false: it relies on a majority, so settled UAVs must upload, too
    bears_means: ClassVar[bool] = False  # true: in clusters the mean of the heads' means takes its place
    asked_void: ClassVar[bool] = False  # true: `step` is called in rounds in which no model arrived, too
    note_bytes: ClassVar[int] = 0  # most bytes of the note that is broadcast with a global model
    state_bytes: ClassVar[int] = 0  # most bytes of a state whose uint8 arrays change their lengths; 0: none does
    reports_metrics: ClassVar[bool] = False  # whether an `Aggregate` of it has metrics
    resumable: ClassVar[bool] = True  # false: its state is not in `state`, so a flight cannot be resumed or taken over

    def __init_subclass__(cls, **more: Any) -> None:
        """A rule that overrides `weights` needs no `step` of its own."""
        super().__init_subclass__(**more)
        if cls.step is Aggregator.step and cls.weights is not Aggregator.weights:
            cls.step = _weighted  # type: ignore[method-assign, assignment]

    def __init__(self, options: Any, scenario: Scenario) -> None:
        """`options`: an instance of `Options`."""
        self.options, self.scenario = options, scenario

    def init(self, parameters: int) -> State:
        """Returns the state before the first round. Checkpoints store the state, and a leader that takes over gets it.

        Names, dtypes and shapes must stay the same, because limits of messages are set at take-off; but uint8 arrays of
        one axis may change their lengths, up to `state_bytes` in all. With the topology `neighbours` each UAV has a
        state of its own.
        """
        return {}

    @abstractmethod
    def step(self, state: State, uploads: Uploads) -> tuple[State, Floats | Aggregate | None]:
        """Returns the state after a round, and its global model, (parameters,), or an `Aggregate`.

        A rule that waits for more models returns None in place of the model. Then the state is stored, and no model is
        broadcast. A fragment that arrived from no other UAV is not broadcast, whatever the model has there, unless the
        rule is `asked_void`.

        Args:
            uploads: at least one model, unless the rule is `asked_void`.
        """
        raise NotImplementedError

    def weights(self, uploads: Uploads) -> Floats | None:
        """Returns the factor of each model, (S,), greater than 0, if the rule is a weighted mean; else None.

        The factor of a model may depend on its own upload alone, and not on `slots`, which are 0 here. One call serves
        all UAVs of a node, in place of a `step` for each; the state is not used.
        """
        return None


def _weighted(rule: Aggregator, state: State, uploads: Uploads) -> tuple[State, Floats]:
    """The step of a rule that is a weighted mean."""
    return state, mean(uploads.models, rule.weights(uploads), uploads.arrived)
