"""The error of the checks, and functions that all suites use."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, NoReturn, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.swarm import threads
from meanflock.swarm.errors import FAILURES, BadInput, last_line
from meanflock.swarm.global_generators import Generators, global_state
from meanflock.swarm.plugins import guard
from meanflock.swarm.plugins.registry import PluginKind, checked, dimensions_of
from meanflock.swarm.scenario import Scenario, as_builtins

T = TypeVar("T")
GONE = (
    "what `init` or an earlier call leaves in `self` is gone after a checkpoint: make what stays the same in "
    "`__init__`, and keep what changes in the arrays that you return"
)
OTHER_THREADS = 2  # a flight has one
THREADS = (
    f"a flight with {OTHER_THREADS} threads of BLAS, OpenMP or torch is not bit-identical",
    "flights use one, but your own programs use more: set the number in `__init__`, as `torch.set_num_threads(1)` "
    "does, or sum in an order of your own",
)


class ConformanceError(AssertionError):
    """A plug-in fails a check of its conformance suite; the text says what to fix."""


def fail(plugin: Any, problem: str, remedy: str) -> NoReturn:
    """Raises ConformanceError."""
    raise ConformanceError(f"{getattr(plugin, '__name__', repr(plugin))}: {problem}; {remedy}")


def scenarios(plugin: Any, given: Scenario | None, uavs: int) -> list[Scenario]:
    """The scenarios in which to check a plug-in: the given one, or the paper's in each of its dimensions."""
    flies = dimensions_of(plugin)
    if given is None:
        return [Scenario(uavs=uavs, **{"space.dimensions": axes}) for axes in flies]
    if given.dimensions not in flies:
        came = f"it flies in {' and '.join(map(str, flies))} dimensions, and the scenario has {given.dimensions}"
        fail(plugin, came, "declare `dimensions`, or set `space.dimensions`")
    return [given]


def check_class(plugin: Any, kind: PluginKind) -> None:
    """Check the class before an instance is made."""
    if not isinstance(plugin, type):
        fail(plugin, "it is no class", "pass the class itself, neither its name nor an instance")
    for attribute in ("name", "Options"):
        if not getattr(plugin, attribute, None):
            fail(plugin, f"it has no `{attribute}`", "derive it from the base class of its kind and give it a name")
    try:
        checked(kind, plugin.name, plugin, plugin.__module__)  # type: ignore[attr-defined]
    except BadInput as error:
        fail(plugin, str(error), "no flight takes it")


def make(plugin: type, options: Mapping[str, Any], *context: Any) -> Any:
    """Make an instance with options, as a flight does."""
    return made(plugin, options, plugin, *context)


def made(plugin: type, options: Mapping[str, Any], maker: Callable[..., Any], *context: Any) -> Any:
    """What `maker` returns for the options and a context."""
    try:
        typed = msgspec.convert(as_builtins(dict(options)), plugin.Options)  # type: ignore[attr-defined]
    except (msgspec.ValidationError, TypeError) as error:
        fail(
            plugin, f"its options {dict(options)} do not fit: {error}", "give every option a default, or pass `options`"
        )
    try:
        return maker(typed, *context)
    except FAILURES as error:
        fail(
            plugin,
            f"it cannot be made: {last_line(error)}",
            "`__init__` takes the options and the scenario, and no more",
        )


def asked(plugin: type, method: Callable[..., T], *given: Any, remedy: str) -> T:
    """Call a method; an exception fails the check."""
    try:
        return method(*given)
    except FAILURES as error:
        fail(plugin, f"`{getattr(method, '__name__', 'it')}` failed: {last_line(error)}", remedy)


def check_kept(plugin: type, label: str, arrays: Any, rows: int | None = None) -> None:
    """Check a memory: arrays by name, finite, of dtypes that a checkpoint stores."""
    try:
        guard.check_memory(label, arrays, rows)
    except (TypeError, ValueError) as error:
        fail(plugin, str(error), "return what a checkpoint keeps")
    for name, array in arrays.items():
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            fail(plugin, f"{label}[{name!r}] is not finite", "guard divisions, roots and empty sums")


def check_same_form(plugin: type, label: str, after: Any, begun: Mapping[str, NDArray[Any]]) -> None:
    """Check that a later memory has the arrays of the first one, with the same dtypes and shapes."""
    try:
        guard.check_same_form(label, after, begun)
    except (TypeError, ValueError) as error:
        fail(plugin, str(error), "begin with all names, and keep dtypes and shapes")


def same(one: NDArray[Any], other: NDArray[Any]) -> bool:
    """Returns whether two arrays have the same shape and bits; all NaNs are equal."""
    one, other = np.asarray(one), np.asarray(other)
    if one.shape != other.shape or one.dtype != other.dtype:
        return False
    if one.dtype.kind == "f" and np.isnan(one).any():
        return bool(np.array_equal(one, other, equal_nan=True))
    return one.tobytes() == other.tobytes()


def alike(one: Mapping[str, NDArray[Any]], other: Mapping[str, NDArray[Any]]) -> str | None:
    """The name of an array in which two memories differ; None if there is none."""
    if set(one) != set(other):
        return ", ".join(sorted(set(one) ^ set(other)))
    return next((name for name in one if not same(one[name], other[name])), None)


def copies(arrays: Iterable[NDArray[Any]]) -> list[NDArray[Any]]:
    """Copies of some arrays."""
    return [np.array(array) for array in arrays]


@contextmanager
def without_draws(plugin: Any, remedy: str) -> Iterator[None]:
    """Context that fails if the plug-in draws in it from a global generator, with a remedy."""
    before = global_state()
    yield
    if global_state() != before:
        fail(plugin, "it draws from a global random generator of Python or NumPy", remedy)


def with_surroundings(plugin: Any, remedy: str, run: Callable[[], T], seed: int, number: int = 1) -> T:
    """Call a function with other seeds of the global generators, and with so many threads of the numeric libraries;
    then restore these. The check fails with `remedy` if the plug-in draws from these generators.
    """
    with threads.limited(number), Generators(seed), without_draws(plugin, remedy):
        return run()
