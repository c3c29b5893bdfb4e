"""The file of a job: the runs it finished, with a checksum and the version of the code that flew them."""

import hashlib
import zlib
from collections.abc import Iterable
from typing import Any

import msgspec
import numpy as np

from meanflock.studies.code_version import version

_MAGIC = b"meanflock job 1\n"
_DIGEST = hashlib.sha256().digest_size


class StoredTrace(msgspec.Struct, frozen=True):
    """One run in full, as bytes, little-endian."""

    shape: tuple[int, int]  # instants, UAVs
    t_s: bytes
    states: bytes
    status: bytes
    weight_t_s: bytes
    weights: bytes


class StoredRun(msgspec.Struct, frozen=True):
    """One finished run. series: (S, columns) little-endian f4, `columns` of them; None where none is kept."""

    key: str
    scalars: dict[str, Any]
    columns: tuple[str, ...] = ()
    series: bytes | None = None
    trace: StoredTrace | None = None

    def table(self) -> dict[str, np.ndarray]:
        """The series by column, NaN where unknown."""
        if self.series is None:
            return {}
        values = np.frombuffer(self.series, "<f4").reshape(-1, len(self.columns))
        return {name: values[:, k] for k, name in enumerate(self.columns)}


class _Body(msgspec.Struct, frozen=True):
    version: str
    runs: tuple[StoredRun, ...]


def encode(runs: Iterable[StoredRun], code: str | None = None) -> bytes:
    """A job file: a line to know it by, the hash of the rest, the rest.

    Args:
        code: version of the code that flew the runs; None: `version()`.
    """
    body = zlib.compress(msgspec.msgpack.encode(_Body(code or version(), tuple(runs))), 1)
    return _MAGIC + hashlib.sha256(body).digest() + body


def decode(raw: bytes, code: str | None = None) -> tuple[StoredRun, ...]:
    """The runs of a job file of this version; `code` as in `encode`.

    Raises:
        ValueError: not whole, not a job file, or of another version.
    """
    if raw[: len(_MAGIC)] != _MAGIC:
        raise ValueError("not a job file")
    digest, body = raw[len(_MAGIC) : len(_MAGIC) + _DIGEST], raw[len(_MAGIC) + _DIGEST :]
    if hashlib.sha256(body).digest() != digest:
        raise ValueError("damaged")
    try:
        content = msgspec.msgpack.decode(zlib.decompress(body), type=_Body)
    except msgspec.MsgspecError as error:
        raise ValueError(str(error)) from error
    if content.version != (code or version()):
        raise ValueError(f"of version {content.version}")
    return content.runs
