"""What a controller declares of itself: everything the swarm needs to know of a method it has never heard of."""

from typing import Any

import msgspec

from meanflock.swarm import plugins
from meanflock.swarm.errors import FAILURES, BadInput

MAX_PARAMETERS = 1_000_000  # floats of a model: 8 MB, and no radio carries it
MAX_DIAGNOSTICS = 100  # columns of a message are counted in one byte
MAX_BROADCASTS = 16  # of a controller in a tick
MAX_BROADCAST_NUMBERS = 4096  # of a UAV in a tick
NO_FILTER = "none"
MAX_MEMORY_BYTES = 24 * 2**20  # of all UAVs together; a flight of more goes on without checkpoints


class Declared(msgspec.Struct, frozen=True):
    """The declarations of one controller with its options.

    parameters: floats of the model it shares with the federation; 0 if it takes part in no rounds.
    parts: sizes of the parts of that model, each of which has a scale of its own where it is written in bytes.
    weights: floats of what it has learned, as it is reported and recorded.
    diagnostics: names of what it reports in every tick.
    period_ticks: ticks between two rounds, where the scenario does not say.
    broadcast_numbers: numbers a UAV broadcasts in a tick at the most, in all its frames; how long a message may be
    follows. pairwise: whether every UAV remembers something of every other; memory then grows with N². shares: whether
    the UAVs broadcast their states by the scenario's `[sharing]`.
    """

    parameters: int
    parts: tuple[int, ...]
    weights: int
    diagnostics: tuple[str, ...]
    period_ticks: int
    broadcast_numbers: int
    pairwise: bool
    shares: bool

    @property
    def is_federated(self) -> bool:
        """Whether there are rounds."""
        return self.parameters > 0


def controller(scenario: Any) -> Any:
    """A new instance of the controller of a `Scenario`, which this module cannot import, with its filter before it.

    Raises:
        BadInput: one of them is not installed here, or its options do not fit.
    """
    return filtered(plugins.create("controller", scenario.method, scenario.controller, scenario), scenario)


def filtered(made: Any, scenario: Any) -> Any:
    """A controller behind the filter of a scenario; itself where there is none.

    Raises:
        BadInput: the filter is not installed here, or its options do not fit; or a declaration of the controller's.
    """
    if scenario.filter.kind == NO_FILTER:
        return made
    declarations_of(made, scenario.method)  # or what is wrong with it would be said of the filter
    return plugins.create("filter", scenario.filter.kind, scenario.filter.options, scenario, made)


def declarations_of(made: Any, name: str) -> Declared:
    """What an instance of the controller `name` declares.

    Raises:
        BadInput: a declaration is of no use.
    """
    try:
        return _checked(made, name)
    except BadInput:
        raise
    except FAILURES as error:  # a class attribute may be anything
        raise BadInput(f"controller {name!r}: a declaration cannot be read: {type(error).__name__}: {error}") from error


def _checked(made: Any, name: str) -> Declared:
    parameters = _count(made, name, "parameters", 0, MAX_PARAMETERS)
    parts = tuple(made.parts) or ((parameters,) if parameters else ())
    if not all(_is_count(part, 1, parameters) for part in parts) or sum(parts) != parameters:
        raise BadInput(f"controller {name!r}: `parts` {parts} do not add up to its {parameters} `parameters`")
    weights = parameters if made.weights is None else _count(made, name, "weights", 0, MAX_PARAMETERS)
    said = _count(made, name, "broadcast_numbers", 0, MAX_BROADCAST_NUMBERS)
    period = _count(made, name, "period_ticks", 1, 2**31)
    if isinstance(made.diagnostics, str):
        raise BadInput(f"controller {name!r}: `diagnostics` is a text; write ({made.diagnostics!r},)")
    diagnostics = tuple(made.diagnostics)
    fine = len(set(diagnostics)) == len(diagnostics) <= MAX_DIAGNOSTICS
    if not fine or not all(isinstance(column, str) and column.isidentifier() for column in diagnostics):
        raise BadInput(
            f"controller {name!r}: `diagnostics` {diagnostics} must be at most {MAX_DIAGNOSTICS} different names of "
            "letters, digits and underscores"
        )
    return Declared(parameters, parts, weights, diagnostics, period, said, bool(made.pairwise), bool(made.shares))


def _count(made: Any, name: str, declaration: str, least: int, most: int) -> int:
    value = getattr(made, declaration)
    if not _is_count(value, least, most):
        raise BadInput(f"controller {name!r}: `{declaration}` is {value!r}; expected {least} … {most}")
    return int(value)


def _is_count(value: object, least: int, most: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and least <= value <= most
