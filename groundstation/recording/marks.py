"""Marks of the map that do not move: lines, circles and words."""

import math

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from meanflock.groundstation.recording.part import Part

Point = tuple[float, float]


def circle(centre: Point, radius: float) -> NDArray[np.float64]:
    """A closed line around a centre, (65, 2), m."""
    angle = np.linspace(0.0, 2.0 * math.pi, 65)
    return np.array(centre) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def line(stream: Part, entity: str, points: NDArray[np.float64], color: int, thickness: float) -> None:
    """Logs a line through `points` (K, 2), m; `thickness` in points."""
    radii = rr.Radius.ui_points(thickness)
    stream.log(entity, rr.LineStrips2D([points], colors=[color], radii=radii, draw_order=1.0))


def label(stream: Part, entity: str, at: Point, text: str, color: int) -> None:
    """Logs text centred below the point `at`, m."""
    point = rr.Points2D([at], labels=[text], colors=[color], radii=0.0, show_labels=True)
    stream.log(entity, point)
