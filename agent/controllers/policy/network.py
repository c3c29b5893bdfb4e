"""A policy as a file: arrays in an `.npz`, read without pickle, and evaluated row by row without BLAS."""

import hashlib
import io
import zipfile
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from meanflock.agent.controllers.policy.perception import width
from meanflock.swarm import paths, state
from meanflock.swarm.errors import FAILURES, BadInput, reason
from meanflock.swarm.state import Floats, Vectors

# The installed policies by number of axes, written by examples/train.py
TRAINED = {
    state.PLANE: Path(__file__).with_name("trained.npz"),
    state.SPACE: Path(__file__).with_name("trained_in_space.npz"),
}
VERSION = 1
MAX_NEIGHBOURS, MAX_MESSAGE, MAX_LAYERS = 64, 64, 8
_MAX_BYTES = 16 * 2**20  # of the arrays of a file
_COUNTS = ("version", "neighbours", "message")
_ARRAYS = (*_COUNTS, "limit", "scale")


class Network(NamedTuple):
    """Layers of weights with tanh between them.

    neighbours: K, observed UAVs. message: W, numbers of a message. limit: largest acceleration along an axis, m/s².
    scale: (I,), the observation is divided by it. layers: weights (I, O) and biases (O,) of each layer; the last has
    d + W outputs, of which d say whether it flies in the plane or in space.
    """

    neighbours: int
    message: int
    limit: float
    scale: Floats
    layers: tuple[tuple[Floats, Floats], ...]

    @property
    def axes(self) -> int:
        """Number of axes d in which it flies."""
        return len(self.layers[-1][1]) - self.message

    def __call__(self, observations: Floats) -> tuple[Vectors, Floats | None]:
        """Accelerations (M, d), m/s², and messages (M, W) in −1 … 1, of observations (M, I).

        Sums go input by input, so that a row has the same bits in every batch.
        """
        values = observations / self.scale
        for weights, biases in self.layers:
            total = np.repeat(biases[None], len(values), axis=0)
            for column, row in enumerate(weights):
                total += values[:, column, None] * row
            values = np.tanh(total)
        return self.limit * values[:, : self.axes], values[:, self.axes :] if self.message else None

    def checked(self) -> Self:
        """The network itself, if its arrays fit each other.

        Raises:
            ValueError: they do not.
        """
        if not (1 <= self.neighbours <= MAX_NEIGHBOURS and 0 <= self.message <= MAX_MESSAGE):
            raise ValueError(
                f"{self.neighbours} neighbours and messages of {self.message} numbers; at most {MAX_NEIGHBOURS} and "
                f"{MAX_MESSAGE}"
            )
        if not 1 <= len(self.layers) <= MAX_LAYERS:
            raise ValueError(f"{len(self.layers)} layers; expected 1 … {MAX_LAYERS}")
        if any(np.ndim(biases) != 1 for _, biases in self.layers) or self.axes not in TRAINED:
            numbers = f"accelerations of 2 or 3 numbers, then {self.message} of a message"
            raise ValueError(f"the last layer has outputs {np.shape(self.layers[-1][1])}; expected {numbers}")
        inputs = width(self.neighbours, self.message, self.axes)
        arrays: list[tuple[str, Any, tuple[int, ...]]] = []
        scale = ("scale", self.scale, (inputs,))
        for number, (weights, biases) in enumerate(self.layers):
            outputs = len(biases)
            arrays += [(f"weights_{number}", weights, (inputs, outputs)), (f"biases_{number}", biases, (outputs,))]
            inputs = outputs
        for name, array, shape in [*arrays, scale, ("limit", self.limit, ())]:
            found = np.asarray(array)
            if found.dtype != np.float64 or found.shape != shape:
                raise ValueError(f"{name} is {found.dtype} {found.shape}; expected float64 {shape}")
            if not np.isfinite(found).all():
                raise ValueError(f"{name} is not finite")
        if self.limit <= 0.0 or not (np.asarray(self.scale) > 0.0).all():
            raise ValueError("limit and scale must be greater than 0")
        return self


def save(path: str | Path, network: Network) -> Path:
    """Write a policy to a file; raises BadInput if it is none, or no file can be made there."""
    try:
        network.checked()
    except ValueError as error:
        raise BadInput(f"policy: {error}") from error
    arrays: dict[str, Any] = {"version": VERSION, "neighbours": network.neighbours, "message": network.message}
    arrays |= {"limit": np.float64(network.limit), "scale": network.scale}
    for number, (weights, biases) in enumerate(network.layers):
        arrays |= {f"weights_{number}": weights, f"biases_{number}": biases}
    content = io.BytesIO()
    np.savez(content, **arrays)
    path = paths.given(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content.getvalue())
    except OSError as error:
        raise BadInput(f"policy {path}: {error.strerror}; name a file that can be written") from error
    return path


def read(path: str | Path) -> tuple[Network, str]:
    """The policy of a file, and the SHA-256 of the file.

    Raises:
        BadInput: it cannot be read, or is no policy of this version.
    """
    path = paths.given(path)
    try:
        if not path.is_file():
            raise BadInput(f"policy {path}: no such file; `controller.file` names the file of a saved policy")
        with path.open("rb") as file:
            content = file.read(_MAX_BYTES + 1)
    except OSError as error:
        raise BadInput(f"policy {path}: {error.strerror}; name a readable file") from error
    try:
        return _network(content), hashlib.sha256(content).hexdigest()
    except FAILURES as error:  # of zipfile, of zlib, and of NumPy, which reads headers as Python
        raise BadInput(f"policy {path}: {reason(error)}; save it with meanflock.env.save_policy") from error


def _network(content: bytes) -> Network:
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        size = sum(entry.file_size for entry in archive.infolist())
    if len(content) > _MAX_BYTES or size > _MAX_BYTES:
        raise ValueError(f"larger than {_MAX_BYTES} bytes")
    # By default, NumPy refuses to unpickle.
    with np.load(io.BytesIO(content)) as arrays:
        version = arrays.get("version")
        if version is None or version.shape != () or version != VERSION:
            raise ValueError(f"version {version}; this meanflock reads version {VERSION}")
        layers = (len(arrays.files) - len(_ARRAYS)) // 2
        names = {f"{kind}_{number}" for kind in ("weights", "biases") for number in range(layers)}
        if set(arrays.files) != {*_ARRAYS, *names}:
            raise ValueError(f"it has {', '.join(sorted(arrays.files))}; expected {', '.join(_ARRAYS)} and layers")
        if any(arrays[name].shape != () or arrays[name].dtype.kind != "i" for name in _COUNTS):
            raise ValueError("neighbours and message must be integers")
        if arrays["limit"].shape != () or arrays["limit"].dtype != np.float64:
            raise ValueError("limit must be a float64")
        pairs = tuple((arrays[f"weights_{number}"], arrays[f"biases_{number}"]) for number in range(layers))
        limit, scale = float(arrays["limit"]), arrays["scale"]
        return Network(int(arrays["neighbours"]), int(arrays["message"]), limit, scale, pairs).checked()
