"""The distributions that all tests of this folder install; they are built once."""

import shutil
import sys
from pathlib import Path

import pytest

from tests.commands import printed
from tests.sources import ROOT
from tests.wheels.building import Distributions


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Distributions:
    """Both, built from a copy of the checkout without what earlier builds and flights left in it."""
    folder = tmp_path_factory.mktemp("built")
    left = shutil.ignore_patterns(".*", "__pycache__", "*.so", "*.egg-info", "build", "dist", "out", "runs", "site")
    shutil.copytree(ROOT, folder / "checkout", symlinks=True, ignore=left)
    printed(sys.executable, "-m", "build", "--outdir", folder / "dist", folder / "checkout", cwd=folder)
    (source,) = (folder / "dist").glob("*.tar.gz")
    (wheel,) = (folder / "dist").glob("*.whl")
    return Distributions(source, wheel)


@pytest.fixture(scope="session")
def wheel(built: Distributions) -> Path:
    """The wheel, for this system and this and every later Python."""
    return built.wheel
