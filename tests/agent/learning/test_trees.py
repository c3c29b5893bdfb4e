"""Trees of arrays become vectors of floats and bytes, and come back."""

from typing import Any

import numpy as np
import pytest

from meanflock.agent.learning.trees import ModelForm
from meanflock.swarm.errors import BadInput

TREE = {
    "net": {"weight": np.arange(6, dtype=np.float32).reshape(2, 3), "bias": np.array([0.5], np.float64)},
    "heads": [np.ones(2, np.float16), np.array([True, False])],
    "steps": np.array(7, np.int64),
    "empty": np.zeros((0, 3), np.float32),
}


def leaves(tree: Any) -> list[np.ndarray]:
    if isinstance(tree, dict):
        return [leaf for branch in tree.values() for leaf in leaves(branch)]
    return [leaf for branch in tree for leaf in leaves(branch)] if isinstance(tree, list) else [tree]


@pytest.mark.parametrize(
    ("integers", "keeps", "parts", "kept"),
    [("send", (), (6, 1, 2, 2, 1), 0), ("keep", (), (6, 1, 2), 10), ("send", ("net.*",), (2, 2, 1), 32)],
)
def test_a_tree_comes_back(integers: str, keeps: tuple[str, ...], parts: tuple[int, ...], kept: int) -> None:
    form = ModelForm(TREE, integers, keeps)
    assert (form.parts, form.parameters, form.kept_bytes) == (parts, sum(parts), kept)
    again = form.join(*form.split(TREE))
    assert list(again) == list(TREE)
    for one, other in zip(leaves(TREE), leaves(again), strict=True):
        assert (one.dtype, one.shape, one.tobytes()) == (other.dtype, other.shape, other.tobytes())


def test_means_of_whole_numbers_are_rounded() -> None:
    form = ModelForm({"steps": np.array(0), "on": np.array(True), "w": np.zeros(1)}, "send", ())
    tree = form.join(np.array([2.5001, 0.4, 1.25]), np.zeros(0, np.uint8))
    assert isinstance(tree, dict)
    assert (tree["steps"], tree["on"], tree["w"]) == (3, False, 1.25)


@pytest.mark.parametrize(
    ("tree", "integers", "keeps", "message"),
    [
        ({"w": np.zeros(2, np.complex64)}, "send", (), "'w' is of complex64; expected floats, integers or booleans"),
        ({"w": np.array(["a"])}, "send", (), "'w' is of <U1"),
        (None, "send", (), "the model is a NoneType; expected an array of NumPy or torch"),
        ({"w": "text"}, "send", (), "'w' is a str; expected an array of NumPy or torch"),
        ({"w": None}, "send", (), "'w' is a NoneType"),
        ({"w": np.zeros(1), "n": np.array([2**24])}, "send", (), "'n' has a number of 2\\*\\*24 or more"),
        ({"w": np.zeros(1), "n": np.array([1])}, "refuse", (), "'n' is of int64; `training.integers` is refuse"),
        ({"w": np.zeros(1)}, "send", ("head.*",), "'head.\\*' fits no array of the model; there are w"),
        ({"w": np.zeros(1)}, "send", ("w",), "no array that is sent"),
        ({}, "send", (), "no array that is sent"),
        ({"a.b": np.zeros(1), "a": {"b": np.ones(1)}}, "send", (), "two arrays 'a.b'"),
    ],
)
def test_a_model_that_cannot_be_sent(tree: Any, integers: str, keeps: tuple[str, ...], message: str) -> None:
    with pytest.raises(BadInput, match=message):
        ModelForm(tree, integers, keeps)


@pytest.mark.parametrize(
    ("tree", "message"),
    [
        ({"w": np.zeros((3, 2), np.float32)}, "'w' has shape \\(3, 2\\); expected \\(2, 3\\)"),
        ({"w": np.zeros((2, 3))}, "'w' is of float64; expected float32"),
        (3.0, "the model has no array with a name; expected w"),
        ({"v": np.zeros((2, 3), np.float32)}, "the model has arrays v; expected w"),
        ({"w": np.zeros((2, 3), np.float32), "v": np.zeros(1)}, "the model has arrays w, v; expected w"),
        (None, "a NoneType; expected an array"),
    ],
)
def test_a_model_that_changed_its_form(tree: Any, message: str) -> None:
    form = ModelForm({"w": np.zeros((2, 3), np.float32)}, "send", ())
    with pytest.raises((ValueError, TypeError, BadInput), match=message):
        form.split(tree)
