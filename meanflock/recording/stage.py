"""The stage of a flight in space: the ground below its mission, a scale of heights, and the camera that sees both."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meanflock.recording import mission_map
from meanflock.swarm import mission, state
from meanflock.swarm.scenario import Obstacle, Scenario

Vectors = NDArray[np.float64]  # (..., 3)

_CELLS, _STEPS = 10, 4  # of the ground's longer side and of the scale of heights, about
_ROOM, _HEADROOM = 0.08, 0.06  # around and above the mission, as shares of its longer side and of its height
_LEAST_SIDE, _LEAST_HEIGHT = 0.5, 0.1  # of the ground, as a share of the height, and the reverse
_FIELD_OF_VIEW = math.radians(55.0)  # of Rerun's camera, from top to bottom
_ALONG_X, _ALONG_Y, _ELEVATION = np.radians((-65.0, -25.0, 28.0)).tolist()  # of the camera, by the longer side
_FAR = 1.4  # times longer than along x is a mission along y
_FILLED = 0.9  # share of the view in which the mission fits


class Camera(NamedTuple):
    """A camera: its place and the middle of what it sees, (3,) m, and the unit vector (3,) to the right in its view."""

    place: Vectors
    target: Vectors
    right: Vectors


class Stage:
    """The stage of a scenario, for one of several `maps` in a window.

    low, high: corners of the ground, (2,) m. cell: side of a cell of the ground's grid, m. heights: round numbers from
    the ground up to more than the highest place of the mission, m. size: the longest side of all, m. camera: the
    nearest that sees all of the mission and its shadow on the ground.
    """

    def __init__(self, scenario: Scenario, maps: int) -> None:
        places = _places(scenario)
        goals, radius = state.flat(mission.all_goals(scenario)), scenario.destination.radius
        across = np.concatenate([state.flat(places), goals - radius, goals + radius])
        low, high = across.min(axis=0), across.max(axis=0)
        side, top = float((high - low).max()), float(places[:, 2].max())
        self._azimuth = _ALONG_Y if side > _FAR * (high[0] - low[0]) else _ALONG_X
        room = max(_ROOM * side, (_LEAST_SIDE * top - side) / 2)
        side, highest = side + 2 * room, max(top, _LEAST_HEIGHT * side)
        self.cell = mission_map.round_length(side / _CELLS)
        self.low = np.floor((low - room) / self.cell) * self.cell
        self.high = np.ceil((high + room) / self.cell) * self.cell
        step = mission_map.round_length(highest / _STEPS)
        self.heights = np.arange(math.ceil((1.0 + _HEADROOM) * highest / step) + 1) * step
        self.size = max(side, float(self.heights[-1]))
        tops = [(*obstacle.disc[:2], self.extent(obstacle)[1]) for obstacle in scenario.obstacles]
        shadows = places * (1.0, 1.0, 0.0)
        seen = np.concatenate([self.scale, self.bar, places, shadows, np.array(tops).reshape(-1, 3)])
        self.camera = self._camera(seen, *mission_map.view_px(maps))

    @property
    def scale(self) -> Vectors:
        """The places of the heights above the corner of the ground that is leftmost in the view, (K, 3) m."""
        return np.array([*self.low, 0.0]) + self.heights[:, None] * (0.0, 0.0, 1.0)

    @property
    def bar(self) -> Vectors:
        """The ends of the side of a cell, on an edge of the ground near the camera, (2, 3) m."""
        end = self.low[0] + self.cell * round((self.high[0] - self.low[0]) / self.cell / 3)
        return np.array([(end - self.cell, self.low[1], 0.0), (end, self.low[1], 0.0)])

    def extent(self, obstacle: Obstacle) -> tuple[float, float]:
        """Lowest and highest point of an obstacle, m; a column without an end is drawn up to the highest height."""
        low, high = _extent(obstacle)
        return low, float(self.heights[-1]) if high is None else high

    def _directions(self) -> tuple[Vectors, Vectors, Vectors]:
        """Unit vectors (3,) to the right, up and toward the camera in its view."""
        x, y, level, rise = *_unit(self._azimuth), *_unit(_ELEVATION)
        return np.array([-y, x, 0.0]), np.array([-rise * x, -rise * y, level]), np.array([level * x, level * y, rise])

    def _camera(self, points: Vectors, wide: float, tall: float) -> Camera:
        """The nearest camera that sees some points (K, 3), m, in a view so `wide` and `tall`.

        The sides of a view are planes with known slopes. So the points that touch two opposite sides do not depend on
        the camera's place, and where these two sides cross is the nearest place.
        """
        right, up, toward = self._directions()
        depth, slope = points @ toward, _FILLED * math.tan(_FIELD_OF_VIEW / 2)
        place, far = np.zeros(3), -math.inf
        for axis, steep in ((right, slope * wide / tall), (up, slope)):
            first, last = (steep * depth - points @ axis).max(), (steep * depth + points @ axis).max()
            place += (last - first) / 2 * axis
            far = max(far, (first + last) / (2 * steep))
        return Camera(place + far * toward, place + float(depth.mean()) * toward, right)


def _unit(angle: float) -> tuple[float, float]:
    return math.cos(angle), math.sin(angle)


def _places(scenario: Scenario) -> Vectors:
    """Starts, goals, landing places, stations, and the ends of obstacles, (K, 3) m."""
    ends = [
        (*obstacle.disc[:2], end) for obstacle in scenario.obstacles for end in _extent(obstacle) if end is not None
    ]
    starts, goals = state.position(mission.starts(scenario)), mission.all_goals(scenario)
    return np.concatenate(
        [starts, goals, mission.landings(scenario), mission.stations(scenario), np.array(ends).reshape(-1, 3)]
    )


def _extent(obstacle: Obstacle) -> tuple[float, float | None]:
    """Lowest and highest point of a sphere or a column, m; None: it has no end."""
    if len(obstacle.centre) == state.SPACE:
        height = obstacle.centre[2]
        return height - obstacle.radius, height + obstacle.radius
    return 0.0, obstacle.height
