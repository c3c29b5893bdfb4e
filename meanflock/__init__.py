"""Fly a swarm that learns over a metered radio, from Python.

    import meanflock as mf

    run = mf.fly("paper", method="mfgfl-hf", seed=7, duration=60)
    run.summary["arrived"], run.states.shape

Importing this loads nothing and changes nothing; every name is looked up when it is first used.
"""

from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any


@cache
def _where() -> dict[str, tuple[str, str]]:
    """Each public name, with its module and its name there, as `__init__.pyi` declares them."""
    imported, public = {}, {}
    for line in map(str.split, Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8").splitlines()):
        match line:
            case ["from", module, "import", name]:  # of a name that is public under another one
                imported[name] = module, name
            case ["from", module, "import", name, "as", _]:
                public[name] = module, name
            case [name, "=", origin]:
                public[name] = imported[origin]
    return public


def __getattr__(name: str) -> Any:
    if name == "__all__":
        return sorted(_where())
    if name.startswith("__") or name not in (where := _where()):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from meanflock.swarm.errors import available

    module, attribute = where[name]
    with available(f"meanflock.{name}", "ground"):
        found = import_module(module)
        value = getattr(found, attribute, None) or import_module(f"{module}.{attribute}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*(name for name in globals() if name.startswith("__")), *_where()})
