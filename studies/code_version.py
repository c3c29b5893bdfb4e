"""The version of the code that decides a run: results of other code are never trusted."""

import ast
import hashlib
from functools import cache
from pathlib import Path

from meanflock import agent, channel, kernels, leader, swarm, worldsim

_ROOMS = (swarm, kernels, agent, channel, leader, worldsim)
_HERE = (
    *("paper/flown.py", "paper/recorder.py", "paper/series.py"),
    *("clusters.py", "leaderboard/flights.py", "../groundstation/launch/engine.py"),
)


@cache
def version() -> str:
    """Package version and a fingerprint of that code.

    The fingerprint is of the syntax trees without docstrings, so words may be mended without flying again.
    """
    digest = hashlib.sha256()
    for room in _ROOMS:
        folder = Path(str(room.__file__)).parent
        for path in sorted(folder.rglob("*.*")):
            if path.suffix == ".py":
                digest.update(path.relative_to(folder).as_posix().encode() + _syntax(path.read_text(encoding="utf-8")))
            elif path.suffix == ".csv":
                digest.update(path.read_bytes())
    for name in _HERE:
        digest.update(_syntax((Path(__file__).parent / name).read_text(encoding="utf-8")))
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
