"""Trees of arrays as vectors of floats, which are sent, and as bytes, which stay with the UAV.

Floats are sent, in the order of the tree. Integers and booleans are sent as float32, or stay with the UAV, by the key
`training.integers`. Arrays whose names fit a pattern of `training.keeps` stay with the UAV. The name of an array is the
path to it, its parts joined by dots.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meanflock.agent.learning.base import Tree
from meanflock.swarm.errors import BadInput
from meanflock.swarm.state import Floats

EXACT = 2.0**24  # float32 has every whole number up to this size


class Leaf(NamedTuple):
    """An array of a tree. is_sent: whether it is sent; it stays with the UAV otherwise."""

    name: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    is_sent: bool

    @property
    def size(self) -> int:
        """Number of its elements."""
        return int(np.prod(self.shape))


class ModelForm:
    """Names, shapes and dtypes of the arrays of a model.

    Attributes:
        parts: sizes of the arrays that are sent. parameters: their sum. kept_bytes: bytes of the others.
        dtype: float32, or float64 if an array has it.
    """

    def __init__(self, tree: Tree, integers: str, keeps: Sequence[str]) -> None:
        """`integers`: see `training.integers`. `keeps`: patterns of names.

        Raises:
            BadInput: the model has an array that cannot be sent, or a pattern fits no name.
        """
        self._tree = tree
        self._leaves = [self._leaf(name, array, integers, keeps) for name, array in arrays_of(tree)]
        names = [leaf.name for leaf in self._leaves]
        if twice := [name for name, count in Counter(names).items() if count > 1]:
            raise BadInput(f"the model has two arrays {twice[0]!r}, its parts joined by dots; rename one of them")
        if unused := [pattern for pattern in keeps if not any(fnmatchcase(name, pattern) for name in names)]:
            raise BadInput(f"`training.keeps` {unused[0]!r} fits no array of the model; there are {', '.join(names)}")
        self._sent = [leaf for leaf in self._leaves if leaf.is_sent]
        self._kept = [leaf for leaf in self._leaves if not leaf.is_sent]
        self.parts = tuple(leaf.size for leaf in self._sent if leaf.size)
        self.parameters = sum(self.parts)
        self.kept_bytes = sum(leaf.size * leaf.dtype.itemsize for leaf in self._kept)
        wide = any(leaf.dtype == np.float64 for leaf in self._sent)
        self.dtype: np.dtype[Any] = np.dtype(np.float64 if wide else np.float32)
        if not self.parameters:
            raise BadInput("the model has no array that is sent; return floats, or keep fewer with `training.keeps`")

    @staticmethod
    def _leaf(name: str, array: NDArray[Any], integers: str, keeps: Sequence[str]) -> Leaf:
        kind = array.dtype.kind
        is_kept = any(fnmatchcase(name, pattern) for pattern in keeps)
        if kind not in "fiub" or array.dtype.itemsize > 8:
            raise BadInput(f"{name!r} is of {array.dtype}; expected floats, integers or booleans")
        if kind != "f" and not is_kept:
            if integers == "refuse":
                raise BadInput(f"{name!r} is of {array.dtype}; `training.integers` is refuse, expected floats")
            is_kept = integers == "keep"
            if not is_kept and np.abs(array.astype(np.float64)).max(initial=0.0) >= EXACT:
                raise BadInput(
                    f"{name!r} has a number of 2**24 or more, which float32 rounds; set training.integers=keep"
                )
        return Leaf(name, array.shape, array.dtype, not is_kept)

    def split(self, tree: Any) -> tuple[NDArray[Any], NDArray[np.uint8]]:
        """The vector (parameters,) and the bytes (kept_bytes,) of a tree.

        Raises:
            ValueError, TypeError: it has other names, shapes or dtypes, or a whole number that float32 rounds.
        """
        found = dict(arrays_of(tree))
        if found.keys() != {leaf.name for leaf in self._leaves}:
            has = f"arrays {', '.join(found)}" if any(found) else "no array with a name"
            raise ValueError(f"the model has {has}; expected {', '.join(one.name for one in self._leaves)}")
        for leaf in self._leaves:
            if found[leaf.name].shape != leaf.shape:
                raise ValueError(f"{leaf.name!r} has shape {found[leaf.name].shape}; expected {leaf.shape}")
            if found[leaf.name].dtype != leaf.dtype:
                raise TypeError(f"{leaf.name!r} is of {found[leaf.name].dtype}; expected {leaf.dtype}")
        parts = [found[leaf.name].astype(self.dtype).reshape(-1) for leaf in self._sent]
        for leaf, part in zip(self._sent, parts, strict=True):
            if leaf.dtype.kind in "iu" and np.abs(part).max(initial=0.0) >= EXACT:
                raise ValueError(f"{leaf.name!r} has a number of 2**24 or more, which float32 rounds")
        kept = b"".join(found[leaf.name].tobytes() for leaf in self._kept)
        return np.concatenate(parts), np.frombuffer(kept, np.uint8)

    def join(self, vector: Floats, kept: NDArray[np.uint8]) -> Tree:
        """The tree of a vector and bytes; its arrays are new. Means of whole numbers are rounded."""
        arrays: list[NDArray[Any]] = []
        raw = kept.tobytes()
        place = begin = 0
        for leaf in self._leaves:
            if leaf.is_sent:
                numbers = vector[place : place + leaf.size].reshape(leaf.shape)
                arrays.append((numbers if leaf.dtype.kind == "f" else np.rint(numbers)).astype(leaf.dtype))
                place += leaf.size
            else:
                end = begin + leaf.size * leaf.dtype.itemsize
                arrays.append(np.frombuffer(raw[begin:end], leaf.dtype).reshape(leaf.shape).copy())
                begin = end
        return _filled(self._tree, iter(arrays))


def arrays_of(tree: Any, path: str = "") -> Iterator[tuple[str, NDArray[Any]]]:
    """Name and array of every leaf of a tree."""
    if not isinstance(tree, Mapping | list | tuple):
        yield path, as_array(path, tree)
        return
    for name, branch in tree.items() if isinstance(tree, Mapping) else enumerate(tree):
        yield from arrays_of(branch, f"{path}.{name}" if path else str(name))


def as_array(name: str, value: Any) -> NDArray[Any]:
    """A NumPy array of a leaf; bfloat16 becomes float32.

    Raises:
        BadInput: it is no array.
    """
    if hasattr(value, "detach"):  # a tensor of torch
        value = value.detach().cpu()
        value = (value.float() if str(value.dtype) == "torch.bfloat16" else value).numpy()
    if not isinstance(value, np.ndarray | np.generic | float | int):
        if not hasattr(value, "__array__"):
            what = repr(name) if name else "the model"
            raise BadInput(f"{what} is a {type(value).__name__}; expected an array of NumPy or torch")
        value = np.asarray(value)
    array = np.asarray(value)
    return array.astype(np.float32) if array.dtype.name == "bfloat16" else array


def _filled(tree: Any, arrays: Iterator[NDArray[Any]]) -> Any:
    """A tree of the same form with other arrays, which come in its order."""
    if isinstance(tree, Mapping):
        return {name: _filled(branch, arrays) for name, branch in tree.items()}
    if isinstance(tree, list | tuple):
        return [_filled(branch, arrays) for branch in tree]
    return next(arrays)
