"""A Python file that is run as it was read."""

from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType


class SourceRead(SourceFileLoader):
    """Runs what was read of a file, whatever the file is by now, and never bytecode: of a file that changed within a
    second, to the same length, it would be that of before."""

    def __init__(self, name: str, path: Path, source: bytes) -> None:
        super().__init__(name, str(path))
        self._source = source

    def get_code(self, fullname: str) -> CodeType:
        """Of what was read."""
        return self.source_to_code(self._source, self.path)
