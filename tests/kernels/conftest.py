"""Both forms of the kernels: what is said of one is said of the other."""

import importlib
import shutil
import sysconfig
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture(params=["compiled", "reference"])
def backend(request: pytest.FixtureRequest) -> ModuleType:
    """`kernels.compiled`, which must be there where a compiler is, or `kernels.reference`."""
    try:
        return importlib.import_module(f"meanflock.kernels.{request.param}")
    except ImportError:
        headers = Path(sysconfig.get_path("include"), "Python.h")
        assert shutil.which("cc") is None or not headers.exists()
        pytest.skip("installed without a C compiler")
