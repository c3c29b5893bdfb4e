"""The conformance suite of codings."""

from collections.abc import Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meanflock.federation.codec import Codec, Cut, starts_of
from meanflock.federation.coding import check_form
from meanflock.federation.codings.base import COARSEST, FINEST, Coding, Models
from meanflock.federation.memory import Feedback
from meanflock.swarm import threads
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario
from meanflock.testing.error import (
    OTHER_THREADS,
    THREADS,
    asked,
    check_class,
    copies,
    fail,
    make,
    same,
    with_surroundings,
)
from meanflock.testing.pace import SLOW_MS, check_pace

PARTS = (9, 1, 14)  # of the models
SIZES = (24, 8)  # numbers of a fragment: a whole model, or a third
ROUNDS = 3
ERRORS = 40  # rounds in which rounding errors are fed back
GROWN = 1e3  # residuals beyond so many times the model grow without end
SWARM, MODEL = 25, 216  # of the paper, to measure the time of a round

_ANY_MODEL = "write any model of finite numbers up to `largest`"
_RANDOM = (
    "draw from `mf.seeds.generator`, by the seed of the scenario, the round and the UAV, and from no other generator"
)
_HIDDEN = (
    "`encode` and `decode` run in several processes, and after checkpoints: keep in `self` only what `__init__` makes"
)
_ROWS = "a row depends on its own model alone: sum and draw by row"
_ELEMENTS = "a number is read without the others, because fragments are: decode each from its own number and scale"


class Written(NamedTuple):
    """Models of a round as a coding writes them, and the weights that a receiver reads."""

    numbers: NDArray[Any]
    scales: NDArray[np.float32]
    weights: NDArray[np.float64]


@threads.limited()
def check_coding(
    coding: type[Coding],
    options: dict[str, Any] | None = None,
    scenario: Scenario | None = None,
    slow_ms: float = SLOW_MS,
) -> None:
    """Writes and reads models, whole and in fragments, and checks everything that the radio relies on.

    Models have numbers of all sizes, and some that no radio carries. They are written one at a time and together, by
    new instances, and with rounding errors that are fed back. A coding that draws from an unseeded generator is found.

    Args:
        coding: the class. options: those of the table [federation.payload_options]. scenario: default: the paper's.
        slow_ms: limit of the median time in which 25 models of 216 numbers are written and read.

    Raises:
        ConformanceError: a check fails; the text says what to fix.
    """
    check_class(coding, "coding")
    suite = _Suite(coding, options or {}, scenario or Scenario())
    suite.check_declared()
    for size in SIZES:
        suite.check_surroundings(size)
        suite.check_rows(size)
        suite.check_unsendable(size)
        suite.check_fragments(size)
    suite.check_any_number()
    suite.check_feedback()
    suite.check_pace(slow_ms)


class _Suite:
    """Checks of one coding."""

    def __init__(self, coding: type[Coding], options: dict[str, Any], scenario: Scenario) -> None:
        self._coding, self._options, self._scenario = coding, options, scenario

    def made(self) -> Coding:
        """A new instance."""
        made: Coding = make(self._coding, self._options, self._scenario)
        return made

    def fail(self, problem: str, remedy: str) -> None:
        """Raises ConformanceError."""
        fail(self._coding, problem, remedy)

    def check_declared(self) -> None:
        """Check the attributes of the class, from which the sizes of messages follow."""
        try:
            check_form(self.made())
        except BadInput as error:
            self.fail(str(error), "no flight takes it")

    def models(self, size: int, number: int) -> Models:
        """Models of a round in fragments of `size` numbers: random ones of all sizes, zeros, and the largest."""
        draw = np.random.default_rng(number)
        largest = min(self._coding.largest, COARSEST)
        normal = draw.standard_normal((6, sum(PARTS)))
        sizes = np.minimum(10.0 ** np.array([0.0, -3.0, 4.0, -60.0, np.log10(largest) - 1.0]), largest / 10.0)
        normal[1:] *= sizes[:, None]
        extreme = np.where(normal[:1] < 0.0, -largest, largest)
        numbers = np.concatenate([normal, np.zeros((1, sum(PARTS))), extreme])
        return Models(numbers, starts_of(PARTS, size), np.arange(len(numbers)), number)

    def encode(self, coding: Coding, models: Models) -> tuple[NDArray[Any], NDArray[np.float32]]:
        """The numbers and scales of models, of checked shapes and types."""
        before = copies(models[:3])
        with np.errstate(all="ignore"):
            answer = asked(self._coding, coding.encode, models, remedy=_ANY_MODEL)
        if not all(same(one, other) for one, other in zip(before, models[:3], strict=True)):
            self.fail("`encode` writes to an array it was given", "return new arrays; copy before you write")
        if not isinstance(answer, tuple) or len(answer) != 2:
            self.fail(f"`encode` returns a {type(answer).__name__}", "return the numbers and the scales")
        numbers, scales = answer
        rows, bits = len(models.numbers), self._coding.bits
        dtype = f"float{bits}" if self._coding.floats else "int8" if bits == 8 else "uint8"
        pieces = len(models.starts) if self._coding.scaled else 0
        for label, array, expected, shape in (
            ("numbers", numbers, dtype, models.numbers.shape),
            ("scales", scales, "float32", (rows, pieces)),
        ):
            if np.shape(array) != shape:
                self.fail(
                    f"`encode` returns {label} of shape {np.shape(array)}, expected {shape}",
                    "as `bits` and `scaled` say",
                )
            if array.dtype != np.dtype(expected):
                self.fail(
                    f"`encode` returns {label} of {array.dtype}, expected {expected}", "as `bits` and `floats` say"
                )
        if bits < 8 and (numbers >= 2**bits).any():
            self.fail(
                f"`encode` returns {numbers.max()}, which has more than {bits} bits", f"return numbers below {2**bits}"
            )
        return numbers, scales

    def valid(self, coding: Coding, numbers: NDArray[Any], scales: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Mask (S,) of the models that can be sent."""
        mask = asked(self._coding, coding.valid, numbers, remedy="return a mask")
        if np.shape(mask) != numbers.shape or np.asarray(mask).dtype != np.bool_:
            self.fail(f"`valid` returns shape {np.shape(mask)}", f"return a mask of shape {numbers.shape}")
        return np.asarray(mask.all(axis=1) & ((scales >= FINEST) & (scales <= COARSEST)).all(axis=1))

    def decode(self, coding: Coding, numbers: NDArray[Any], scales: NDArray[np.float64]) -> NDArray[np.float64]:
        """The weights of numbers and their scales."""
        before = copies((numbers, scales))
        weights = asked(self._coding, coding.decode, numbers, scales, remedy="read all that `valid` accepts")
        if not (same(before[0], numbers) and same(before[1], scales)):
            self.fail("`decode` writes to an array it was given", "return new arrays; copy before you write")
        if np.shape(weights) != numbers.shape or np.asarray(weights).dtype != np.float64:
            found = f"{np.asarray(weights).dtype} of shape {np.shape(weights)}"
            self.fail(f"`decode` returns {found}", f"return float64 of shape {numbers.shape}, a weight for each number")
        if not np.isfinite(weights).all():
            self.fail("`decode` returns a weight that is not finite", "let `valid` refuse the number, or bound it")
        return np.asarray(weights)

    def written(self, models: Models) -> Written:
        """Models as one instance writes them, and another one reads them."""
        coding = self.made()
        numbers, scales = self.encode(coding, models)
        valid = self.valid(coding, numbers, scales)
        if not valid.all():
            row = models.numbers[np.flatnonzero(~valid)[0]]
            self.fail(
                f"a model of numbers up to {np.abs(row).max():g} is not `valid`", f"{_ANY_MODEL}, or declare `largest`"
            )
        return Written(numbers, scales, self.decode(self.made(), numbers, self.spread(models, scales)))

    def spread(self, models: Models, scales: NDArray[np.float32]) -> NDArray[np.float64]:
        """The scale of every number; (S, 0) without scales."""
        return models.spread(scales) if self._coding.scaled else scales.astype(np.float64)

    def check_surroundings(self, size: int) -> None:
        """Check that the same models are written the same way again, with other threads, and by one instance."""

        def rounds() -> list[Written]:
            return [self.written(self.models(size, number)) for number in range(1, ROUNDS + 1)]

        def continued() -> list[Written]:
            coding, result = self.made(), []
            for number in range(1, ROUNDS + 1):
                models = self.models(size, number)
                numbers, scales = self.encode(coding, models)
                weights = self.decode(coding, numbers, self.spread(models, scales))
                result.append(Written(numbers, scales, weights))
            return result

        surrounded = partial(with_surroundings, self._coding, _RANDOM)
        first = surrounded(rounds, 1)
        for again, problem, remedy in (
            (surrounded(rounds, 2), "the same models differed in a second run", _RANDOM),
            (surrounded(rounds, 1, OTHER_THREADS), *THREADS),
            (surrounded(continued, 1), "rounds that continue from a checkpoint differ", _HIDDEN),
        ):
            for one, other in zip(first, again, strict=True):
                if not all(map(same, one, other)):
                    self.fail(problem, remedy)

    def check_rows(self, size: int) -> None:
        """Check that a model alone is written as among others."""
        models = self.models(size, 1)
        together = self.written(models)
        for row in range(len(models.numbers)):
            only = slice(row, row + 1)
            alone = self.written(models._replace(numbers=models.numbers[only], uavs=models.uavs[only]))
            pairs: Iterator[tuple[Any, Any]] = zip(alone, together, strict=True)
            if not all(same(one, other[only]) for one, other in pairs):
                self.fail("a model alone is written in another way than among others", _ROWS)

    def check_unsendable(self, size: int) -> None:
        """Check that a model with a number that is not finite is not valid, and leaves the others as they are."""
        models = self.models(size, 1)
        expected, coding = self.written(models), self.made()
        others = np.arange(len(models.numbers)) != 1
        for bad in (np.nan, np.inf, -np.inf):
            numbers = models.numbers.copy()
            numbers[1, 3] = bad
            wrong, scales = self.encode(coding, models._replace(numbers=numbers))
            if self.valid(coding, wrong, scales)[1]:
                self.fail(f"a model that has {bad} is `valid`", "let its scale or a number be one that `valid` refuses")
            if not (same(wrong[others], expected.numbers[others]) and same(scales[others], expected.scales[others])):
                self.fail(f"a model that has {bad} changes how others are written", _ROWS)

    def check_fragments(self, size: int) -> None:
        """Check that fragments, each read alone, are the model."""
        models, coding = self.models(size, 1), self.made()
        codec = Codec(coding, PARTS, None if size == sum(PARTS) else Cut(1, size, 1))
        coded = codec.encode(models.numbers, models.uavs, 1)
        rows = codec.rows(coded, np.ones((len(models.numbers), 1)))
        alone = [codec.read(rows[k : k + 1]).values for k in range(len(rows))]
        values = np.concatenate(alone).astype(np.float64).reshape(len(models.numbers), codec.count, -1)
        if not same(codec.model(values), self.written(models).weights):
            self.fail("fragments that are read alone are not the model", _ELEMENTS)

    def check_any_number(self) -> None:
        """Check that every number that `valid` accepts is read as a finite weight, with the extreme scales."""
        if self._coding.floats:
            return
        bits, coding = self._coding.bits, self.made()
        every = np.arange(2**bits, dtype=np.uint8).view(np.int8 if bits == 8 else np.uint8)[None]
        mask = asked(self._coding, coding.valid, every, remedy="return a mask")
        numbers = every[:, np.asarray(mask)[0]]
        for scale in (FINEST, COARSEST) if self._coding.scaled else (1.0,):
            shape = numbers.shape if self._coding.scaled else (1, 0)
            self.decode(coding, numbers, np.full(shape, scale))

    def check_feedback(self) -> None:
        """Check that rounding errors that are added to the next upload do not grow without end."""
        coding, uavs = self.made(), np.arange(2)
        feedback = Feedback(Codec(coding, PARTS), uavs, active=True)
        models = np.random.default_rng(7).standard_normal((2, sum(PARTS)))
        for number in range(1, ERRORS + 1):
            feedback.encode(uavs, models, number)
        assert feedback.residuals is not None
        grown = np.abs(feedback.residuals).max() / np.abs(models).max()
        if not grown < GROWN:
            problem = f"rounding errors that are fed back grow to {grown:.0f} times the model in {ERRORS} rounds"
            self.fail(
                problem, "write numbers that are nearer to the model: with smaller scales, or scales by mean size"
            )

    def check_pace(self, slow_ms: float) -> None:
        """Check the time in which models of the paper's swarm are written and read."""
        coding, uavs = self.made(), np.arange(SWARM)
        codec = Codec(coding, (MODEL,))
        many = np.random.default_rng(6).standard_normal((SWARM, MODEL))
        check_pace(
            self._coding,
            f"a round of {SWARM} models",
            slow_ms,
            lambda number: codec.decode(codec.encode(many, uavs, number)),
        )
