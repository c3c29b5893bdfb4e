"""The version of the code that decides a run: results of other code are never trusted."""

import ast
import hashlib
from functools import cache
from pathlib import Path

from meanflock import agent, channel, federation, kernels, leader, swarm, worldsim

_ROOMS = (swarm, federation, kernels, agent, channel, leader, worldsim)
_FLYING = (  # files of other packages that decide a run too
    *("clusters.py", "communication.py"),
    *("leaderboard/flights.py", "../groundstation/launch/engine.py"),
)


@cache
def version(*more: Path) -> str:
    """Package version and a fingerprint of that code.

    The fingerprint is of the syntax trees without docstrings: a change of words alone needs no new flights.

    Args:
        more: Python files outside the package that decide a run too.
    """
    digest = hashlib.sha256()
    for room in _ROOMS:
        folder = Path(str(room.__file__)).parent
        for path in sorted(folder.rglob("*.*")):
            if path.suffix == ".py":
                digest.update(path.relative_to(folder).as_posix().encode() + _syntax(path.read_text(encoding="utf-8")))
            elif path.suffix == ".csv":
                digest.update(path.read_bytes())
    for path in (*(Path(__file__).parent / name for name in _FLYING), *more):
        digest.update(_syntax(path.read_text(encoding="utf-8")))
    return f"{swarm.__version__}+{digest.hexdigest()[:12]}"


def _syntax(source: str) -> bytes:
    tree = ast.parse(source)
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if (
            isinstance(body, list)
            and body
            and isinstance(body[0], ast.Expr)
            and isinstance(body[0].value, ast.Constant)
        ):
            body[0].value.value = None
    return ast.dump(tree).encode()
