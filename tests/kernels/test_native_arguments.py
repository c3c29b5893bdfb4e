"""Arguments of the compiled functions: a wrong one is refused before anything is written, at any alignment."""

from typing import Any

import numpy as np
import pytest

from meanflock.agent.controllers.mean_field.learner import tables
from meanflock.kernels.mean_field.layout import packed
from meanflock.swarm.scenario import load

native = pytest.importorskip("meanflock.kernels._native")

READ_ONLY = np.zeros((2, 2))
READ_ONLY.flags.writeable = False
ODD_STRIDES = np.zeros((2, 8))[:, ::2]


def arguments(name: str) -> dict[str, Any]:
    """Good arguments of a function; those that it writes to are full of sevens."""
    draw = np.random.default_rng(1)
    if name == "learn":
        return {
            "tables": native.tables(*packed(tables(load(None, ["uavs=9"], method="mfg")))),
            "states": draw.normal(size=(2, 4)),
            "weights": np.zeros((2, 246)),
            "around": np.zeros((2, 9, 4)),
            "weights_out": np.full((2, 246), 7.0),
            "numbers": np.full((2, 5), 7.0),
        }
    if name == "repel":
        known, pushed = draw.normal(size=(2, 9, 4)), np.full((2, 2), 7.0)
        return {"states": np.zeros((2, 4)), "known": known, "weight": 5.0, "range_m": 0.5, "pushed": pushed}
    if name == "nearest":
        planes = {"normals": draw.normal(size=(2, 3, 2)), "bounds": np.zeros((2, 3)), "limit": 3.0}
        return {"wanted": np.ones((2, 2)), **planes, "found": np.full((2, 2), 7.0), "missing": np.full(2, 7.0)}
    if name == "fade":
        links = {"busy": np.arange(2), "missing": np.full(2, 7), "slots": np.full(2, 7)}
        return {"normal": np.ones((2, 2)), "xi": 1.0, "chi": 1.0, "thresholds": np.full(2, np.inf), "slot": 1, **links}
    if name == "poisson":
        return {"rates": np.ones(2), "first": np.ones(2), "terms": 3, "reached": np.ones(4), "sums": np.full(2, 7.0)}
    if name == "move":
        pushes = {"acceleration": np.ones((2, 2)), "noise": np.ones((2, 2)), "wind": np.zeros((2, 2))}
        return {
            "states": np.ones((2, 4)),
            **pushes,
            "drag": 0.1,
            "shake": 0.2,
            "dt": 0.1,
            "moved": np.full((2, 4), 7.0),
        }
    if name == "reached":
        return {"states": np.full((2, 4), 7.0), "goals": np.ones((2, 4)), "radius": 1.0, "within": np.ones(2, bool)}
    states = {"before": draw.normal(size=(2, 4)), "after": draw.normal(size=(2, 4))}
    return {**states, "hazard": 9.0, "collision": 9.0, "nearest": np.inf, "found": np.full((2, 2), 7, np.intp)}


WRONG: list[tuple[str, str, Any, str]] = [
    ("learn", "states", np.zeros((3, 4)), "weights: .* expected"),
    ("learn", "states", ODD_STRIDES, "contiguous"),
    ("learn", "weights", np.zeros((2, 246), np.int64), "weights: format"),
    ("learn", "around", np.zeros((2, 9, 3)), "around: .* 2 rows"),
    ("learn", "around", np.zeros((2, 0, 4)), "around: 0 bytes"),
    ("learn", "around", np.zeros(3), "around: 24 bytes, expected 16"),
    ("learn", "weights_out", bytes(8 * 2 * 246), "(?i)writable"),
    ("learn", "numbers", np.zeros((2, 4)), "numbers: .* expected"),
    ("learn", "tables", object(), "PyCapsule"),
    ("repel", "states", np.zeros((2, 4), np.float32), "states: format f"),
    ("repel", "known", np.zeros((2, 9, 3)), "known: .* expected"),
    ("repel", "pushed", np.zeros((3, 2)), "pushed: 48 bytes"),
    ("nearest", "wanted", np.zeros((2, 2), np.float32), "wanted: format f"),
    ("nearest", "normals", np.zeros((2, 3)), "normals: 48 bytes"),
    ("nearest", "bounds", np.zeros((2, 4)), "bounds: 64 bytes, expected 48"),
    ("nearest", "found", np.zeros((2, 3)), "found: 48 bytes"),
    ("nearest", "found", READ_ONLY, "(?i)read-only|writable"),
    ("nearest", "missing", np.zeros(3), "missing: 24 bytes"),
    ("fade", "normal", np.zeros(3), "normal: 24 bytes"),
    ("fade", "normal", np.zeros((2, 4))[:, ::2], "contiguous"),
    ("fade", "normal", np.zeros((3, 2)), "not a link"),
    ("fade", "thresholds", np.zeros(3), "not a link"),
    ("fade", "thresholds", np.zeros(2, np.float32), "thresholds: format f"),
    ("fade", "busy", np.array([0, 2]), "not a link"),
    ("fade", "busy", np.array([-1, 0]), "not a link"),
    ("fade", "busy", np.zeros(2, np.int32), "busy: format i"),
    ("fade", "missing", np.zeros(3, np.int64), "not a link"),
    ("fade", "missing", np.zeros(2), "missing: format d"),
    ("fade", "slots", bytes(16), "(?i)writable"),
    ("poisson", "rates", np.zeros(3), "first: 16 bytes"),
    ("poisson", "first", np.array([0.0, -1.0]), "no first terms"),
    ("poisson", "first", np.array([0.0, np.nan]), "no first terms"),
    ("poisson", "reached", np.zeros(0), "nothing reached"),
    ("poisson", "sums", np.zeros(3), "sums: 24 bytes"),
    ("poisson", "sums", READ_ONLY[0], "(?i)read-only|writable"),
    ("move", "states", np.zeros(3), "states: 24 bytes"),
    ("move", "acceleration", np.zeros((3, 2)), "acceleration: 48 bytes"),
    ("move", "noise", np.zeros((2, 2), np.float32), "noise: format f"),
    ("move", "wind", np.zeros(3), "wind: 24 bytes"),
    ("move", "wind", np.zeros((3, 2)), "wind: not one"),
    ("move", "moved", np.zeros((2, 3)), "moved: 48 bytes"),
    ("move", "moved", bytes(64), "(?i)writable"),
    ("reached", "goals", np.zeros((2, 3)), "goals: 48 bytes"),
    ("reached", "within", np.zeros(3, bool), "within: 3 bytes"),
    ("reached", "within", np.zeros(2, np.int8), "within: format b"),
    ("pairs", "after", np.zeros((1, 4)), "after: 32 bytes, expected 64"),
    ("pairs", "before", np.zeros((2, 4), np.int64), "before: format"),
    ("pairs", "before", [0.0] * 8, "bytes-like"),
    ("pairs", "found", np.zeros(3, np.intp), "found: 24 bytes"),
    ("pairs", "found", np.zeros((2, 2), np.int32), "found: format i"),
]


@pytest.mark.parametrize(("function", "name", "wrong", "expected"), WRONG)
def test_a_wrong_argument_is_refused_before_anything_is_written(
    function: str, name: str, wrong: Any, expected: str
) -> None:
    good = arguments(function)
    written = [array for array in good.values() if isinstance(array, np.ndarray) and (array == 7).all()]
    with pytest.raises((TypeError, ValueError, BufferError), match=expected):
        getattr(native, function)(*(good | {name: wrong}).values())
    assert written
    assert all((array == 7).all() for array in written)


@pytest.mark.parametrize("function", ["learn", "repel", "nearest", "fade", "poisson", "move", "reached", "pairs"])
def test_an_array_may_begin_at_any_byte(function: str) -> None:
    def shifted(value: Any) -> Any:
        if not isinstance(value, np.ndarray):
            return value
        raw = bytearray(b"." + value.tobytes())
        return np.frombuffer(raw, dtype=value.dtype, offset=1).reshape(value.shape)

    aligned = arguments(function)
    odd = {name: shifted(value) for name, value in aligned.items()}
    assert getattr(native, function)(*odd.values()) == getattr(native, function)(*aligned.values())
    for name, value in aligned.items():
        np.testing.assert_array_equal(odd[name], value)
