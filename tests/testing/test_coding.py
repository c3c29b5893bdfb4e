"""The suite of codings says what is wrong with one."""

import re
from typing import Any

import numpy as np
import pytest

import meanflock as mf
from meanflock.federation.codings.base import COARSEST
from meanflock.federation.codings.int8 import Int8
from meanflock.federation.codings.plain import Float16, Float32
from meanflock.testing import ConformanceError, check_coding
from tests.testing.good import GoodCoding, changed, having, writing


def answer(place: int, change: Any) -> type:
    """The good coding with one of the two arrays of `encode` changed."""

    def encode(_self: Any, found: Any, *_: Any) -> Any:
        parts = list(found)
        parts[place] = change(parts[place])
        return tuple(parts)

    return changed(GoodCoding, "encode", encode)


class Private(GoodCoding):
    """Hands something from `encode` to `decode` that the radio does not carry."""

    name = "private"
    shift = 0.0

    def encode(self, models: Any) -> Any:
        self.shift = 1.0
        return super().encode(models)

    def decode(self, numbers: Any, scales: Any) -> Any:
        return super().decode(numbers, scales) + self.shift


def write(_self: Any, found: Any, models: Any) -> Any:
    models.numbers[:] = 0.0
    return found


WRONG: dict[str, tuple[type, str]] = {  # what is checked, and a part of the verdict
    "bits": (having(GoodCoding, bits=3), "`bits` is 3; of integers expected one of (1, 2, 4, 8)"),
    "bits of floats": (having(Float32, bits=8), "`bits` is 8; of floats expected one of (16, 32, 64)"),
    "largest": (having(GoodCoding, largest=np.inf), "`largest` is inf; expected a finite number"),
    "type": (answer(0, lambda numbers: numbers.astype(np.int64)), "numbers of int64, expected uint8; as `bits`"),
    "more bits": (answer(0, lambda numbers: numbers + np.uint8(200)), "has more than 4 bits; return numbers below 16"),
    "shape": (answer(0, lambda numbers: numbers[:, 1:]), "numbers of shape (8, 23), expected (8, 24)"),
    "scales": (answer(1, lambda scales: scales[:, :1]), "scales of shape (8, 1), expected (8, 3)"),
    "float64": (answer(1, lambda scales: scales.astype(np.float64)), "scales of float64, expected float32"),
    "no scales": (having(GoodCoding, scaled=False), "scales of shape (8, 3), expected (8, 0); as `bits` and `scaled`"),
    "writes models": (changed(GoodCoding, "encode", write), "`encode` writes to an array it was given"),
    "writes numbers": (writing(GoodCoding, "decode", 1), "`decode` writes to an array it was given"),
    "mask": (having(GoodCoding, valid=lambda _self, numbers: True), "`valid` returns shape (); return a mask"),
    "never valid": (
        having(GoodCoding, valid=lambda _self, numbers: np.zeros(numbers.shape, dtype=bool)),
        "is not `valid`; write any model of finite numbers up to `largest`, or declare `largest`",
    ),
    "small numbers only": (having(Float16, largest=1e30), "is not `valid`"),
    "weights": (
        changed(GoodCoding, "decode", lambda _self, found, *_: found[:, 1:]),
        "float64 of shape (8, 23); return",
    ),
    "float32": (changed(GoodCoding, "decode", lambda _self, found, *_: found.astype(np.float32)), "returns float32"),
    "not finite": (changed(GoodCoding, "decode", lambda _self, found, *_: found / 0.0), "is not finite; let `valid`"),
    "hostile": (
        changed(GoodCoding, "decode", lambda _self, found, numbers, _: np.where(numbers == 0, np.inf, found)),
        "a weight that is not finite; let `valid` refuse the number",
    ),
    "rows": (
        answer(1, lambda scales: np.broadcast_to(scales.max(axis=0), scales.shape)),
        "a model alone is written in another way than among others; a row depends on its own model",
    ),
    "NaN": (
        answer(1, lambda scales: np.where(scales <= COARSEST, scales, np.float32(1.0))),
        "a model that has nan is `valid`; let its scale",
    ),
    "elements": (
        changed(GoodCoding, "decode", lambda _self, found, *_: found + found.sum(axis=1, keepdims=True)),
        "fragments that are read alone are not the model; a number is read without the others",
    ),
    "private": (
        Private,
        "rounds that continue from a checkpoint differ; `encode` and `decode` run in several processes",
    ),
    "arguments": (
        having(GoodCoding, decode=lambda self, numbers: numbers),
        "`decode` takes (self, numbers); write decode(self, numbers, scales); no flight takes it",
    ),
    "far off": (
        changed(GoodCoding, "decode", lambda _self, found, *_: 3.0 * found),
        "rounding errors that are fed back grow to",
    ),
}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("mistake", WRONG)
def test_what_is_wrong_with_a_coding(mistake: str) -> None:
    coding, expected = WRONG[mistake]
    with pytest.raises(ConformanceError, match=re.escape(expected)):
        check_coding(coding)


def test_a_coding_has_its_options_and_scenario() -> None:
    class Optional(Int8):
        name = "optional"

        class Options(mf.Options, frozen=True):
            share: float = 1.0

        def encode(self, models: Any) -> Any:
            assert (self.options.share, self.scenario.uavs) == (0.5, 9)
            return super().encode(models)

    check_coding(Optional, {"share": 0.5}, mf.Scenario(uavs=9))
