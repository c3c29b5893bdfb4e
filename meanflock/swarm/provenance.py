"""Provenance of a flight: which code, Python, NumPy and plug-ins flew it."""

import json
import platform
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

_ROOT = Path(__file__).resolve().parents[2]  # of the checkout, if it is one


def provenance(plugins: Iterable[tuple[str, str, str]]) -> dict[str, Any]:
    """The versions of the code that flies in this process.

    Args:
        plugins: kind, name, and version of the package or hash of the file, of each plug-in.
    """
    return {
        "commit": commit(),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "plugins": {kind: f"{name}, {fingerprint}" for kind, name, fingerprint in plugins},
    }


@cache
def commit(root: Path = _ROOT) -> str | None:
    """The commit of the checkout that runs, or from which pip installed the package; None if there is none.

    Changes that were not committed do not show.
    """
    try:
        return _head(root) if (root / ".git").exists() else _installed()
    except (OSError, ValueError, LookupError, ImportError):
        return None


def _head(root: Path) -> str:
    """The commit that is checked out, read from the files of Git; a worktree has a file that names its folder."""
    folder = root / ".git"
    if folder.is_file():
        folder = root / folder.read_text(encoding="utf-8").removeprefix("gitdir:").strip()
    head = (folder / "HEAD").read_text(encoding="utf-8").strip()
    if not head.startswith("ref: "):
        return head
    branch = head.removeprefix("ref: ")
    other = folder / "commondir"
    common = folder / other.read_text(encoding="utf-8").strip() if other.exists() else folder
    if (common / branch).is_file():
        return (common / branch).read_text(encoding="utf-8").strip()
    packed = (common / "packed-refs").read_text(encoding="utf-8").splitlines()
    return {name: sha for sha, _, name in (line.partition(" ") for line in packed)}[branch]


def _installed() -> str | None:
    """The commit from which pip installed the package, as in `pip install git+https://…`."""
    from importlib import metadata  # only here: it takes time to load

    text = metadata.distribution("meanflock").read_text("direct_url.json")
    found: str | None = json.loads(text or "{}").get("vcs_info", {}).get("commit_id")
    return found
