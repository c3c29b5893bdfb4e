"""Distributions, and environments in which they are installed."""

import sys
from pathlib import Path
from typing import NamedTuple

from tests.commands import printed


class Distributions(NamedTuple):
    """What `python -m build` makes; it builds the wheel from the source distribution."""

    source: Path
    wheel: Path


def made_environment(interpreter: Path, folder: Path, *wanted: str) -> Path:
    """The interpreter of a new environment in `folder` with the wanted packages. Our pip installs them."""
    folder.mkdir(parents=True, exist_ok=True)
    printed(interpreter, "-m", "venv", "--without-pip", folder, cwd=folder)
    python = folder / "bin" / "python"
    printed(sys.executable, "-m", "pip", "--python", python, "install", "-q", "--no-compile", *wanted, cwd=folder)
    return python
