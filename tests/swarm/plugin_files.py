"""Plug-ins in files."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
SPRING = ROOT / "examples" / "spring.py"
GOOD = """
import numpy as np
from meanflock.agent.controllers.base import Controller, Step

class Mine(Controller):
    name = "mine"

    def init(self, uavs, plan):
        return {}

    def step(self, memory, tick, own, received):
        return Step(memory, -own[:, 2:])
"""


def written(folder: Path, text: str, name: str = "mine.py") -> Path:
    (path := folder / name).write_text(text, encoding="utf-8")
    return path
