"""Files with a controller, as users write them."""

from pathlib import Path
from textwrap import indent

_TEXT = """import meanflock as mf
{top}

class Mine(mf.Controller):
    name = "{name}"

    def step(self, memory, tick, own, received):
{step}
"""


def controller_text(name: str, step: str, top: str = "") -> str:
    """A file whose controller does `step`, lines of Python; those in `top` run when it is imported."""
    return _TEXT.format(top=top, name=name, step=indent(step, " " * 8))


def controller_file(folder: Path, name: str, step: str, top: str = "") -> Path:
    path = folder / f"{name}.py"
    path.write_text(controller_text(name, step, top), encoding="utf-8")
    return path
