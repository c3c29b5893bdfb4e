"""A checksum for what a Parquet file has none for: its footer, which says what lies where.

Pages of rows have theirs. That of the footer lies between the last page and the footer, where no reader looks: every
reader of Parquet reads the file as before.
"""

from os import SEEK_END
from pathlib import Path
from typing import BinaryIO
from zlib import crc32

_MARK = b"mf\x89seal\n"
_SEAL_BYTES = len(_MARK) + 4
_TAIL_BYTES = 8  # the footer's length, and Parquet's own mark


def seal(path: Path) -> None:
    """Adds the checksum to a file that is complete. Raises OSError where there is no room for it."""
    with path.open("r+b") as file:
        begins, footer = _footer(file)
        file.seek(begins)
        file.write(_MARK + crc32(footer).to_bytes(4, "little") + footer)


def check(path: Path) -> None:
    """Compares it; a file without one, of 0.1.0, passes. Raises OSError where the footer is not what was written."""
    with path.open("rb") as file:
        begins, footer = _footer(file)
        file.seek(max(0, begins - _SEAL_BYTES))
        kept = file.read(_SEAL_BYTES)
        if kept[: len(_MARK)] == _MARK and kept[len(_MARK) :] != crc32(footer).to_bytes(4, "little"):
            raise OSError("damaged: the checksum of its footer is wrong")


def _footer(file: BinaryIO) -> tuple[int, bytes]:
    """Where it begins, and all from there to the end; whatever lies there, where this is no Parquet file."""
    size = file.seek(0, SEEK_END)
    file.seek(max(0, size - _TAIL_BYTES))
    length = int.from_bytes(file.read(4), "little")
    begins = max(0, size - _TAIL_BYTES - length)
    file.seek(begins)
    return begins, file.read()
