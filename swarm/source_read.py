"""A Python file that is run as it was read."""

from importlib.machinery import SourceFileLoader
from pathlib import Path
from typing import Any


class SourceRead(SourceFileLoader):
    """Runs what was read of a file, whatever the file is by now.

    It looks for no bytecode and leaves none: of a file that changed within a second, to the same length, it would be
    that of before.
    """

    def __init__(self, name: str, path: Path, source: bytes) -> None:
        super().__init__(name, str(path))
        self._source = source

    def get_data(self, path: Any) -> bytes:
        """What was read, for the interpreter."""
        return self._source

    def path_stats(self, path: Any) -> dict[str, Any]:
        """None that bytecode could be held to.

        Raises:
            OSError: always.
        """
        raise OSError("as it was read")
