"""The file of a job: its finished runs, with a checksum and the version of the code that flew them."""

import ast
import hashlib
import zlib
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from meanflock import agent, channel, federation, kernels, leader, swarm, worldsim
from meanflock.swarm.paths import LOG_BYTES

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
    """Encode a job file: a magic line, the hash of the rest, the rest.

    Args:
        code: version of the code that flew the runs; None: `version()`.
    """
    body = zlib.compress(msgspec.msgpack.encode(_Body(code or version(), tuple(runs))), 1)
    return _MAGIC + hashlib.sha256(body).digest() + body


def decode(raw: bytes, code: str | None = None) -> tuple[StoredRun, ...]:
    """The runs of a job file of this version; `code` as in `encode`.

    Raises:
        ValueError: incomplete, not a job file, or of another version.
    """
    if raw[: len(_MAGIC)] != _MAGIC:
        raise ValueError("not a job file")
    digest, body = raw[len(_MAGIC) : len(_MAGIC) + _DIGEST], raw[len(_MAGIC) + _DIGEST :]
    if hashlib.sha256(body).digest() != digest:
        raise ValueError("damaged")
    try:
        unpacked = zlib.decompressobj()
        content = msgspec.msgpack.decode(unpacked.decompress(body, LOG_BYTES), type=_Body)
    except (msgspec.MsgspecError, zlib.error) as error:
        raise ValueError(str(error)) from error
    if content.version != (code or version()):
        raise ValueError(f"of version {content.version}")
    return content.runs


_ROOMS = (swarm, federation, kernels, agent, channel, leader, worldsim)
_FLYING = (  # files of other packages on which a run depends
    "leaderboard/flights.py",
    "../launch/engine.py",
)


@cache
def version(*more: Path) -> str:
    """Package version, and a fingerprint of the code on which a run depends.

    The fingerprint is of the syntax trees without docstrings: a change of words alone needs no new flights.

    Args:
        more: Python files outside the package on which a run depends.
    """
    digest = hashlib.sha256()
    for room in _ROOMS:
        folder = Path(str(room.__file__)).parent
        for path in sorted(folder.rglob("*.*")):
            if path.suffix == ".py":
                digest.update(path.relative_to(folder).as_posix().encode() + _syntax(path.read_text(encoding="utf-8")))
            elif path.suffix == ".csv":
                digest.update(path.read_bytes())
    for path in (*(Path(__file__).parent / name for name in _FLYING), *more):
        digest.update(_syntax(path.read_text(encoding="utf-8")))
    return f"{swarm.__version__}+{digest.hexdigest()[:12]}"


def _syntax(source: str) -> bytes:
    """The syntax tree of a module without docstrings, in half the time of `ast.walk` and `ast.dump`."""
    told: list[str] = []
    _tell(ast.parse(source), told)
    return "".join(told).encode()


def _tell(node: ast.AST, told: list[str]) -> None:
    told.append(f"{node.__class__.__name__}(")
    for name in node._fields:
        value = getattr(node, name, None)
        several = value if isinstance(value, list) else [value]
        has_words = name == "body" and several and _is_text(several[0])
        told.append(f" {name}:")
        for each in several[1:] if has_words else several:
            if isinstance(each, ast.AST):
                _tell(each, told)
            else:
                told.append(f"{each!r},")
    told.append(")")


def _is_text(statement: Any) -> bool:
    return isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)
