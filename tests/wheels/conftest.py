"""The distributions that all tests of this folder install, built once, and environments for them."""

import shutil
import sys
from pathlib import Path

import pytest

from tests.commands import printed
from tests.sources import ROOT


def made_environment(interpreter: Path, folder: Path, *wanted: str) -> Path:
    """The interpreter of a new environment in `folder` with the wanted packages. Our pip installs them."""
    folder.mkdir(parents=True, exist_ok=True)
    printed(interpreter, "-m", "venv", "--without-pip", folder, cwd=folder)
    python = folder / "bin" / "python"
    printed(sys.executable, "-m", "pip", "--python", python, "install", "-q", "--no-compile", *wanted, cwd=folder)
    return python


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with both, built from a copy of the checkout without what earlier builds and flights left in it."""
    folder = tmp_path_factory.mktemp("built")
    left = shutil.ignore_patterns(".*", "__pycache__", "*.so", "*.egg-info", "build", "dist", "out", "runs", "site")
    shutil.copytree(ROOT, folder / "checkout", symlinks=True, ignore=left)
    printed(sys.executable, "-m", "build", "--outdir", folder / "dist", folder / "checkout", cwd=folder)
    return folder / "dist"


@pytest.fixture(scope="session")
def wheel(built: Path) -> Path:
    """The wheel, built from the source distribution, for this system and this and every later Python."""
    (made,) = built.glob("*.whl")
    return made
