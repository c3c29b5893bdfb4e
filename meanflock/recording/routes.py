"""Waypoints of a mission, as recordings show them."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from meanflock.recording import drawing
from meanflock.swarm import mission
from meanflock.swarm.scenario import Scenario

_MOST_WORDS = 20  # waypoints of a route that have a word each


class Route(NamedTuple):
    """Waypoints that UAVs share.

    name: of their group; empty: they are those of the flight. places: (K, d) m, in their order.
    """

    name: str
    color: int
    places: NDArray[np.float64]

    @property
    def words(self) -> list[str]:
        """A word for each waypoint; none for those of a long route but the first and the last."""
        last = len(self.places)
        shown = range(1, last + 1) if last <= _MOST_WORDS else (1, last)
        return [f"waypoint {number}" if number in shown else "" for number in range(1, last + 1)]


def routes(scenario: Scenario) -> list[Route]:
    """The waypoints of the flight, in green, and those of each group that has its own, in its colour."""
    found: dict[str, Route] = {}
    for number, (_, destination) in enumerate(mission.destinations(scenario)):
        if destination.waypoints:
            name = "" if destination is scenario.destination else scenario.groups[number].name
            color = drawing.group_color(number) if name else drawing.GREEN
            places = scenario.space.vectors(destination.waypoints, scenario.start.height)
            found[name] = Route(name, color, places)
    return list(found.values())


def has_route(scenario: Scenario) -> NDArray[np.bool_]:
    """Mask (N,) of the UAVs that have waypoints."""
    mask = np.zeros(scenario.uavs, dtype=bool)
    for rows, destination in mission.destinations(scenario):
        mask[rows] = len(destination.waypoints) > 0
    return mask
