"""Results of a race: samples of a quantity, its floor and its target."""

import enum
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from statistics import median
from typing import Any, Literal

Say = Callable[[str], None]  # progress, in a few words


class Effort(enum.Enum):
    """How much to measure."""

    FULL = "full"
    QUICK = "quick"

    def choose(self, full: int, quick: int) -> int:
        """The count for this effort."""
        return full if self is Effort.FULL else quick


@dataclass
class Figure:
    """Samples of one quantity.

    floor: the figure of the same race it is compared with, sample by sample where there are as many.
    target, stretch: bounds on the median; `ratio_stretch`: on the median ratio to the floor.
    """

    name: str
    unit: str
    samples: list[float]
    better: Literal["lower", "higher", "neither"] = "lower"
    floor: "Figure | None" = None
    target: float | None = None
    stretch: float | None = None
    ratio_target: float | None = None
    ratio_stretch: float | None = None
    note: str = ""

    @property
    def ratios(self) -> list[float]:
        """To the floor; empty without one."""
        if self.floor is None or not self.samples or not self.floor.samples:
            return []
        if len(self.floor.samples) == len(self.samples):
            return [mine / its for mine, its in zip(self.samples, self.floor.samples, strict=True)]
        return [median(self.samples) / median(self.floor.samples)]

    def record(self) -> dict[str, Any]:
        """Record for `latest.json`; unknown is null."""
        ratios = self.ratios
        return {
            "name": self.name,
            "unit": self.unit,
            "better": self.better,
            "median": median(self.samples) if self.samples else None,
            "min": min(self.samples, default=None),
            "max": max(self.samples, default=None),
            "samples": len(self.samples),
            "floor": self.floor.name if self.floor else None,
            "ratio": median(ratios) if ratios else None,
            "ratio_min": min(ratios, default=None),
            "ratio_max": max(ratios, default=None),
            "target": self.target,
            "stretch": self.stretch,
            "ratio_target": self.ratio_target,
            "ratio_stretch": self.ratio_stretch,
            "note": self.note,
        }


@dataclass
class Outcome:
    """Result of a race; `notes`: sentences for the page. `details`: further numbers."""

    figures: list[Figure] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    details: dict[str, Any] = field(default_factory=dict)


def in_turns(repeats: int, measures: Mapping[str, Callable[[], float]]) -> dict[str, list[float]]:
    """Samples of every measure, taken in turns: A, B, …, A, B, …"""
    samples: dict[str, list[float]] = {name: [] for name in measures}
    for _ in range(repeats):
        for name, measure in measures.items():
            samples[name].append(measure())
    return samples


def per_call_ms(call: Callable[[], object], count: int) -> float:
    """Mean wall time of `count` calls, ms each."""
    start = time.perf_counter()
    for _ in range(count):
        call()
    return (time.perf_counter() - start) / count * 1e3


def per_tick_ms(ticks: Iterator[int], count: int) -> float:
    """Mean wall time of the next `count` ticks of a flight, ms each."""
    return per_call_ms(lambda: next(ticks), count)
