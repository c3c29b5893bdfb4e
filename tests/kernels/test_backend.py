"""The form of the kernels is chosen at import; an extension of other sources is refused."""

import importlib
import shutil
from pathlib import Path

import pytest

from meanflock import kernels
from meanflock.kernels import sources


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
