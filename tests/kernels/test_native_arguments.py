"""Compiled functions: an extension of other sources is refused, and wrong arguments before anything is written."""

import importlib
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from meanflock import kernels
from meanflock.agent.controllers.mean_field.learner import tables
from meanflock.kernels import sources
from meanflock.kernels.mean_field.layout import packed
from meanflock.swarm.scenario import load

native = pytest.importorskip("meanflock.kernels._native")


def arguments(name: str) -> dict[str, Any]:
    """Good arguments of a function; those that it writes to are full of sevens."""
    draw = np.random.default_rng(1)
    if name == "learn":
        prepared = native.tables(*packed(tables(load(None, ["uavs=9"], method="mfg"))))
        read = {"states": draw.normal(size=(2, 4)), "weights": np.zeros((2, 246)), "around": np.zeros((2, 9, 4))}
        return {"tables": prepared, **read, "weights_out": np.full((2, 246), 7.0), "numbers": np.full((2, 5), 7.0)}
    if name == "repel":
        known, pushed = draw.normal(size=(2, 9, 4)), np.full((2, 2), 7.0)
        return {"states": np.zeros((2, 4)), "known": known, "weight": 5.0, "range_m": 0.5, "pushed": pushed}
    if name == "nearest":
        planes = {"normals": draw.normal(size=(2, 3, 2)), "bounds": np.zeros((2, 3)), "limit": 3.0}
        return {"wanted": np.ones((2, 2)), **planes, "found": np.full((2, 2), 7.0), "missing": np.full(2, 7.0)}
    if name == "fade":
        links = {"busy": np.arange(2), "missing": np.full(2, 7), "slots": np.full(2, 7)}
        return {"normal": np.ones((2, 2)), "xi": 1.0, "chi": 1.0, "thresholds": np.full(2, np.inf), "slot": 1, **links}
    if name == "send":
        links = {"busy": np.arange(2), "missing": np.full(2, 7), "slots": np.full(2, 7)}
        return {"uniform": np.ones(2), "success": np.zeros(2), "slot": 1, **links}
    if name == "waves":
        return {"place": np.ones((2, 2)), "vectors": np.ones((2, 3)), "phase": np.ones(3), "sums": np.full(2, 7.0)}
    if name == "interpolate":
        links = {"row": np.array([0, 1]), "place": np.ones(2)}
        return {"tables": draw.normal(size=(3, 2, 4)), **links, "found": np.full((3, 2), 7.0)}
    if name == "poisson":
        return {"rates": np.ones(2), "first": np.ones(2), "terms": 3, "reached": np.ones(4), "sums": np.full(2, 7.0)}
    if name == "move":
        pushes = {"acceleration": np.ones((2, 2)), "noise": np.ones((2, 2)), "wind": np.zeros((2, 2))}
        constants = {"drag": 0.1, "shake": 0.2, "dt": 0.1}
        return {"states": np.ones((2, 4)), **pushes, **constants, "moved": np.full((2, 4), 7.0)}
    if name == "fly":
        read = {"states": np.ones((2, 6)), "body": np.eye(2, 12), "wanted": np.ones((2, 3)), "outside": np.ones((2, 3))}
        read["body"][1, :2] = 1.0, 0.0
        return {
            "craft": np.ones(13),
            **read,
            "steps": 2,
            "moved": np.full((2, 6), 7.0),
            "turned": np.full((2, 12), 7.0),
        }
    if name == "reached":
        return {"states": np.full((2, 4), 7.0), "goals": np.ones((2, 4)), "radius": 1.0, "within": np.ones(2, bool)}
    if name == "closest":
        return {"distance": np.ones((2, 5)), "reach": 2.0, "found": np.full((2, 3), 7, np.intp)}
    if name == "neighbours":
        read = {"own": np.ones((2, 4)), "others": np.ones((2, 4, 5)), "uavs": np.array([0, 4]), "reach": 9.0}
        written = {"away": np.full((2, 3, 2), 7.0), "closing": np.full((2, 3, 2), 7.0), "squared": np.full((2, 3), 7.0)}
        return {**read, **written, "found": np.full((2, 3), 7, np.intp)}
    if name == "pick":
        read = {"links": np.array([[0, 4], [1, 2], [1, 3]], np.int32), "chosen": np.array([True, False, True])}
        return {**read, "picked": np.full((3, 2), 7, np.int32), "used": np.full(2, 7, np.intp)}
    if name == "solve":
        return {"matrices": np.ones((2, 3, 3)), "rights": np.ones((2, 3, 2)), "found": np.full((2, 3, 2), 7.0)}
    if name == "multiply":
        return {"left": np.ones((2, 3, 4)), "right": np.ones((2, 4, 2)), "found": np.full((2, 3, 2), 7.0)}
    states = {"before": draw.normal(size=(2, 4)), "after": draw.normal(size=(2, 4))}
    return {**states, "hazard": 9.0, "collision": 9.0, "nearest": np.inf, "found": np.full((2, 2), 7, np.intp)}


ANY_BYTE = (
    "neighbours",
    "pick",
    "learn",
    "repel",
    "nearest",
    "fade",
    "send",
    "waves",
    "interpolate",
    "poisson",
    "move",
    "fly",
    "reached",
    "pairs",
)
FUNCTIONS = ("closest", "solve", "multiply", *ANY_BYTE)
# May be longer than what is read of them.
FREE = {("fade", "busy"), ("send", "busy"), ("poisson", "reached"), ("pick", "used")}
# Of the right size and type, but with numbers or a length that would lead astray.
WRONG: list[tuple[str, str, Any]] = [
    ("learn", "around", np.zeros((2, 0, 4))),
    ("learn", "tables", object()),
    ("nearest", "bounds", np.zeros((2, 4))),
    ("fade", "busy", np.array([0, 2])),
    ("fade", "busy", np.array([-1, 0])),
    ("send", "busy", np.array([0, 2])),
    ("send", "busy", np.array([-1, 0])),
    ("interpolate", "row", np.array([0, 2])),
    ("interpolate", "row", np.array([-1, 0])),
    ("interpolate", "tables", np.ones((3, 4, 1))),
    ("interpolate", "tables", np.ones((2, 2, 4))),
    ("interpolate", "tables", np.ones((3, 8))),
    ("poisson", "first", np.array([0.0, -1.0])),
    ("poisson", "first", np.array([0.0, np.nan])),
    ("poisson", "reached", np.zeros(0)),
    ("move", "wind", np.zeros((3, 2))),
    ("pairs", "before", [0.0] * 8),
    ("pairs", "before", np.zeros((1, 8))),
    ("pairs", "after", np.zeros((2, 6))),
    ("move", "states", np.ones((2, 6))),
    ("move", "states", np.ones(())),
    ("reached", "goals", np.ones((2, 6))),
    ("fly", "states", np.ones((2, 4))),
    ("fly", "steps", "2"),
    ("fly", "body", np.zeros((2, 12))),
    ("closest", "distance", np.ones((3, 5))),
    ("closest", "distance", np.ones(10)),
    ("neighbours", "own", np.ones((2, 6))),
    ("neighbours", "own", np.ones((3, 4))),
    ("neighbours", "others", np.ones((2, 20))),
    ("neighbours", "others", np.ones((2, 6, 5))),
    ("neighbours", "others", np.ones((2, 4, 4))),
    ("neighbours", "uavs", np.array([0, -1])),
    ("neighbours", "uavs", np.array([0, 5])),
    ("neighbours", "found", np.full(6, 7, np.intp)),
    ("neighbours", "found", np.full((2, 2), 7, np.intp)),
    ("pick", "links", np.array([[0, 4], [1, 2], [2, 3]], np.int32)),
    ("pick", "links", np.array([[0, 4], [1, 2], [-1, 3]], np.int32)),
    ("pick", "links", np.zeros((2, 2), np.int32)),
    ("pick", "chosen", np.ones(2, bool)),
    ("solve", "matrices", np.ones((2, 3, 2))),
    ("solve", "rights", np.ones((2, 4, 2))),
    ("multiply", "right", np.ones((2, 3, 2))),
    ("multiply", "left", np.ones((3, 3, 4))),
    ("multiply", "left", np.ones((3, 4))),
]


def mutations(array: np.ndarray, is_written: bool) -> dict[str, Any]:
    """Arguments that are wrong in place of a good one."""
    other = array.astype(np.float32 if array.dtype.kind == "f" else np.int16)
    wrong = {"another type": other, "too long": np.append(array, array.flat[0])}
    wrong["not contiguous"] = np.repeat(array, 2, axis=-1)[..., ::2]
    return wrong | ({"read-only": array.tobytes(), "too short": array.flat[1:].copy()} if is_written else {})


def refused(function: str, name: str, wrong: Any) -> None:
    """Checks that one wrong argument is refused, and that nothing was written."""
    good = arguments(function)
    written = [array for array in good.values() if isinstance(array, np.ndarray) and (array == 7).all()]
    with pytest.raises((TypeError, ValueError, BufferError)):
        getattr(native, function)(*(good | {name: wrong}).values())
    assert written
    assert all((array == 7).all() for array in written)


@pytest.mark.parametrize("function", FUNCTIONS)
def test_an_array_of_another_size_type_or_order_is_refused_before_anything_is_written(function: str) -> None:
    for name, array in arguments(function).items():
        if isinstance(array, np.ndarray):
            for mutation, wrong in mutations(array, bool((array == 7).all())).items():
                if mutation != "too long" or (function, name) not in FREE:
                    refused(function, name, wrong)


@pytest.mark.parametrize(("function", "name", "wrong"), WRONG)
def test_a_wrong_argument_is_refused_before_anything_is_written(function: str, name: str, wrong: Any) -> None:
    refused(function, name, wrong)


@pytest.mark.parametrize("function", ANY_BYTE)
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


def test_an_extension_of_other_sources_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An update brings new sources, and the extension of the old ones is still there."""
    if kernels.BACKEND != "compiled":
        pytest.skip("nothing is compiled here")
    compiled = importlib.import_module("meanflock.kernels.compiled")
    assert sources.checksum() == compiled.SOURCES
    copy = shutil.copytree(sources.HERE, tmp_path / "kernels")
    monkeypatch.setattr(sources, "HERE", copy)
    importlib.reload(compiled)  # where they are does not matter
    with (copy / "all_pairs.c").open("a") as file:
        file.write("/* changed */\n")
    with pytest.raises(ImportError, match="other sources"):
        importlib.reload(compiled)
