"""The form of the kernels is chosen at import; an extension of other sources is refused."""

import importlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from meanflock import kernels
from meanflock.kernels import sources
from tests.polling import DEADLINE_S

ROOT = Path(__file__).parents[2]


def python(code: str, *arguments: str, pure: str) -> str:
    told = {**os.environ, "MEANFLOCK_PURE": pure}
    command = [sys.executable, "-c", code, *arguments]
    done = subprocess.run(command, cwd=ROOT, env=told, capture_output=True, text=True, timeout=DEADLINE_S, check=True)
    return done.stdout


@pytest.mark.parametrize("pure", ["1", "0", ""])
def test_only_the_variable_chooses_numpy(pure: str) -> None:
    expected = "numpy" if pure == "1" else kernels.BACKEND
    assert python("from meanflock import kernels; print(kernels.BACKEND)", pure=pure).strip() == expected


def test_an_extension_of_other_sources_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An update brings new sources, and the extension of the old ones is still there."""
    if kernels.BACKEND != "compiled":
        pytest.skip("nothing is compiled here")
    compiled = importlib.import_module("meanflock.kernels.compiled")
    assert sources.checksum() == compiled.SOURCES
    copy = shutil.copytree(sources.HERE, tmp_path / "kernels")
    monkeypatch.setattr(sources, "HERE", copy)
    importlib.reload(compiled)  # where they are does not matter
    with (copy / "all_pairs.c").open("a") as file:
        file.write("/* changed */\n")
    with pytest.raises(ImportError, match="other sources"):
        importlib.reload(compiled)
