"""What pyproject.toml cannot say: the extension carries the checksum of the sources that it is built from."""

import runpy
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.build_ext import build_ext


class Marked(build_ext):
    """As ever, with the checksum that `meanflock.kernels.compiled` looks at."""

    def build_extension(self, ext: Extension) -> None:
        """Defines SOURCES."""
        checksum = runpy.run_path(str(Path(__file__).parent / "kernels/sources.py"))["checksum"]
        ext.define_macros.append(("SOURCES", f"{checksum()}u"))
        super().build_extension(ext)


setup(cmdclass={"build_ext": Marked})
