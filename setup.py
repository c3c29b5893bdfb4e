"""The packages, four of which lie beside the others, and the extension, which carries the checksum of its sources."""

import runpy
from pathlib import Path

from setuptools import Extension, find_packages, setup
from setuptools.command.build_ext import build_ext

# Top-level folders that are imported as meanflock.<name>; the links in meanflock/ do not enter a build.
ROOMS = ("agent", "channel", "leader", "worldsim")

packages = {"meanflock", *(f"meanflock.{name}" for name in find_packages("meanflock"))}
for room in ROOMS:
    packages |= {f"meanflock.{room}", *(f"meanflock.{room}.{name}" for name in find_packages(room))}


class BuildWithChecksum(build_ext):
    """Builds the extension with the checksum that `meanflock.kernels.compiled` compares."""

    def build_extension(self, ext: Extension) -> None:
        """Define SOURCES, then compile."""
        checksum = runpy.run_path(str(Path(__file__).parent / "meanflock/kernels/sources.py"))["checksum"]
        ext.define_macros.append(("SOURCES", f"{checksum()}u"))
        super().build_extension(ext)


setup(
    packages=sorted(packages),
    package_dir={f"meanflock.{room}": room for room in ROOMS},
    cmdclass={"build_ext": BuildWithChecksum},
)
