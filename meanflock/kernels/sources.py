"""Checksum of the C sources here, by which an extension that was built from other sources is recognised."""

import zlib
from importlib.util import find_spec
from pathlib import Path

HERE = Path(__file__).parent


def checksum() -> int:
    """CRC-32 of the C sources, names included; 0 where there are none, as in a wheel."""
    files = sorted(HERE.rglob("*.[ch]"))
    named = (path.relative_to(HERE).as_posix().encode() + path.read_bytes() for path in files)
    return zlib.crc32(b"".join(named)) if files else 0


def built() -> bool:
    """Returns whether there is an extension, built from any sources."""
    return find_spec("meanflock.kernels._native") is not None
