"""The C sources that lie here, by which an extension built from others is known."""

import zlib
from importlib.util import find_spec
from pathlib import Path

HERE = Path(__file__).parent


def checksum() -> int:
    """CRC-32 of the C sources, names included; 0 where there are none, as in a wheel."""
    files = sorted(HERE.glob("*.[ch]"))
    return zlib.crc32(b"".join(path.name.encode() + path.read_bytes() for path in files)) if files else 0


def built() -> bool:
    """Whether there is an extension, of whatever sources."""
    return find_spec("meanflock.kernels._native") is not None
