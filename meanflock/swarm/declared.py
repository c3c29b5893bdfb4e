"""Declarations of a controller: all that the swarm knows about it."""

import importlib
from collections.abc import Collection, Mapping
from contextlib import suppress
from typing import Any

import msgspec

from meanflock.swarm import plugins
from meanflock.swarm.counts import count_of
from meanflock.swarm.errors import FAILURES, BadInput

MAX_PARAMETERS = 10_000_000  # floats of a model, 80 MB
MAX_DIAGNOSTICS = 100  # a message counts its columns in one byte
MAX_BROADCASTS = 16  # of a controller in a tick
MAX_BROADCAST_NUMBERS = 4096  # of a UAV in a tick
NO_FILTER = NO_LEARNER = "none"
_MEMORY_BYTES, _UAV_MEMORY_BYTES = 256 * 2**20, 2**13  # of a swarm, and of a UAV of a large swarm
MEMORY_TICKS = 100  # memories are checked in multiples of it, in which checkpoints are due
PRESENT = "meanflock.present"  # (M,) in the memory of a node: rows that have one; the others begin anew
MAX_NOTE_BYTES = 65_000  # of a note that is sent with a model
MAX_STATE_BYTES = 24 * 2**20  # of an aggregation rule


def most_memory(uavs: int) -> int:
    """Most bytes of the memories of so many UAVs together; a flight with more memory has no checkpoints."""
    return max(_MEMORY_BYTES, _UAV_MEMORY_BYTES * uavs)


class Declared(msgspec.Struct, frozen=True):
    """The declarations of one controller with its options.

    parameters: floats of the model that it shares with the federation; 0 without rounds.
    parts: block sizes of that model; int8 scales each block separately.
    weights: floats of the learned weights that are reported and recorded.
    diagnostics: names of the diagnostics of a tick.
    period_ticks: ticks between two rounds, if the scenario does not set them.
    broadcast_numbers: most numbers that a UAV broadcasts in a tick, all frames together; limits the length of messages.
    pairwise: whether a UAV has memory for each other UAV; memory then grows with N².
    shares: whether the UAVs broadcast their states by the scenario's `[sharing]`.
    weighted: whether each model is sent with a weight.
    note_bytes: most bytes of a note that is sent with a model.
    dated: whether each model is sent with the round of the global model that its training began with.
    busy: name of the diagnostic that is 1 while a UAV trains, else 0; empty if none does.
    measured: names of the diagnostics of trainings, which a UAV has while the last of them is above 0.
    guided: whether goals can change in flight.
    recorded: options that the controller fills in, by name: hashes of the files that it flies.
    """

    parameters: int
    parts: tuple[int, ...]
    weights: int
    diagnostics: tuple[str, ...]
    period_ticks: int
    broadcast_numbers: int
    pairwise: bool
    shares: bool
    weighted: bool
    note_bytes: int
    dated: bool
    busy: str
    measured: tuple[str, ...]
    guided: bool
    recorded: Mapping[str, str]

    @property
    def is_federated(self) -> bool:
        """Returns whether the controller takes part in rounds."""
        return self.parameters > 0


def controller(scenario: Any) -> Any:
    """A new instance of the controller of a `Scenario` (which this module cannot import), behind learner and filter.

    Raises:
        BadInput: one of them is not installed here, its options do not fit, or it does not fly in the dimensions of the
            scenario; or the controller and the learner both have a model.
    """
    plugins.check_dimensions("controller", scenario.method, scenario.dimensions)
    alone = plugins.create("controller", scenario.method, scenario.controller, scenario)
    return filtered(learning(alone, scenario), scenario)


def learning(instance: Any, scenario: Any) -> Any:
    """A controller that trains with the learner of a scenario; the controller itself without a learner.

    Raises:
        BadInput: the learner is not installed here, its options do not fit, or the controller has a model.
    """
    name = scenario.training.learner
    if name == NO_LEARNER:
        return instance
    if declarations_of(instance, scenario.method).is_federated:
        raise BadInput(
            f"controller {scenario.method!r} shares a model of its own, so learner {name!r} cannot share another; take "
            f"a --method without one: {', '.join(_without_model(scenario))}"
        )
    options = plugins.options_of("learner", name, scenario.training.options)
    found = importlib.import_module("meanflock.agent.learning.controller")  # by name, as a plug-in
    return found.Learning(options, scenario, instance, plugins.load("learner", name))


def _without_model(scenario: Any) -> list[str]:
    """Names of the controllers that fly without options and share no model."""
    found = []
    for name in plugins.names("controller"):
        with suppress(BadInput):
            if not plugins.create("controller", name, {}, scenario).parameters:
                found.append(name)
    return found


def filtered(instance: Any, scenario: Any) -> Any:
    """A controller behind the filter of a scenario; the controller itself without a filter.

    Raises:
        BadInput: the filter is not installed here, or its options or a declaration of the controller do not fit.
    """
    if scenario.filter.kind == NO_FILTER:
        return instance
    plugins.check_dimensions("filter", scenario.filter.kind, scenario.dimensions)
    declarations_of(instance, scenario.method)  # first, so that an error names the controller and not the filter
    return plugins.create("filter", scenario.filter.kind, scenario.filter.options, scenario, instance)


def declarations_of(instance: Any, name: str) -> Declared:
    """The declarations of an instance of the controller `name`.

    Raises:
        BadInput: a declaration is invalid.
    """
    try:
        return _checked(instance, name)
    except BadInput:
        raise
    except FAILURES as error:  # a class attribute may be anything
        raise BadInput(f"controller {name!r}: a declaration cannot be read: {type(error).__name__}: {error}") from error


def _checked(instance: Any, name: str) -> Declared:
    parameters = _count(instance, name, "parameters", 0, MAX_PARAMETERS)
    part = f"controller {name!r}: a number of `parts` is"
    parts = tuple(count_of(part, size, 1, parameters) for size in instance.parts) or (parameters,) * bool(parameters)
    if sum(parts) != parameters:
        raise BadInput(f"controller {name!r}: `parts` {parts} do not add up to its {parameters} `parameters`")
    weights = parameters if instance.weights is None else _count(instance, name, "weights", 0, MAX_PARAMETERS)
    broadcast_numbers = _count(instance, name, "broadcast_numbers", 0, MAX_BROADCAST_NUMBERS)
    period = _count(instance, name, "period_ticks", 1, 2**31)
    diagnostics = column_names(f"controller {name!r}: `diagnostics`", instance.diagnostics)
    return Declared(
        parameters=parameters,
        parts=parts,
        weights=weights,
        diagnostics=diagnostics,
        period_ticks=period,
        broadcast_numbers=broadcast_numbers,
        pairwise=bool(instance.pairwise),
        shares=bool(instance.shares),
        weighted=bool(instance.weighted),
        note_bytes=_count(instance, name, "note_bytes", 0, MAX_NOTE_BYTES),
        dated=bool(instance.dated),
        busy=instance.busy,
        measured=tuple(instance.measured),
        guided=bool(getattr(instance, "guided", False)),
        recorded=dict(getattr(instance, "recorded", {})),
    )


def column_names(label: str, given: Any, taken: Collection[str] = ()) -> tuple[str, ...]:
    """The names of columns that a class declares; the errors begin with `label`.

    `taken`: names that it may not declare.

    Raises:
        BadInput: they are not different names, too many, or one is taken.
    """
    if isinstance(given, str):
        raise BadInput(f"{label} is a text; write ({given!r},)")
    if not isinstance(given, tuple | list):
        raise BadInput(f"{label} is {given!r}; write a tuple of names, () for none")
    names = tuple(given)
    distinct = len(set(names)) == len(names) <= MAX_DIAGNOSTICS
    if not distinct or not all(isinstance(column, str) and column.isidentifier() for column in names):
        raise BadInput(
            f"{label} {names} must be at most {MAX_DIAGNOSTICS} different names of letters, digits and underscores"
        )
    if both := [name for name in names if name in taken]:
        raise BadInput(f"{label} has {both[0]!r}, a column that meanflock adds; give yours another name")
    return names


def _count(instance: Any, name: str, declaration: str, least: int, most: int) -> int:
    return count_of(f"controller {name!r}: `{declaration}` is", getattr(instance, declaration), least, most)
