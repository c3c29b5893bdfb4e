"""Which form of the kernels runs is decided once, and no flight shows it."""

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
def test_a_variable_chooses_numpy_and_nothing_else_does(pure: str) -> None:
    native = kernels.BACKEND == "compiled" or pure == "1"
    expected = "numpy" if pure == "1" else "compiled" if native else "numpy"
    assert python("from meanflock import kernels; print(kernels.BACKEND)", pure=pure).strip() == expected


def test_both_forms_have_the_same_names() -> None:
    names = {"BACKEND", "alignment", "columns", "learn", "nearest", "pairs", "prepare", "read", "repel", "write"}
    assert set(kernels.__all__) == names
    for module in ("compiled", "reference"):
        code = f"import meanflock.kernels.{module} as m; print(*sorted({names!r} & set(vars(m))))"
        if module == "compiled" and kernels.BACKEND != "compiled":
            continue
        assert set(python(code, pure="1").split()) == names


def test_an_extension_built_from_other_sources_is_not_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_an_extension_without_sources_beside_it_is_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As a wheel has it."""
    monkeypatch.setattr(sources, "HERE", tmp_path)
    assert sources.checksum() == 0
    if kernels.BACKEND == "compiled":
        importlib.reload(importlib.import_module("meanflock.kernels.compiled"))
