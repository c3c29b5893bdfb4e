"""A small SVG drawing of a run: paths on the map, starts, goals, obstacles, stations and collisions."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from meanflock.results.flown import FlownKeys
from meanflock.results.plots import plotstyle
from meanflock.results.plots.run import places_of
from meanflock.results.plots.run_picture import RunPicture, parts_of
from meanflock.results.series import per_uav
from meanflock.swarm import mission, state
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario

Floats = NDArray[np.float64]

WIDTH, HEIGHT = 400, 300
_MARGIN = 18
_MOST_POINTS = 3000  # of all paths
_MOST_MARKS = 300  # of a kind
_LEAST_M = 1.0  # smallest extent
_BARS = (1, 2, 5)  # lengths of the scale bar, times a power of ten


COLUMNS = ["x_m", "y_m"]  # of the time series, that a drawing needs


def thumbnail(run: RunPicture) -> str:
    """The drawing of a run, as an SVG element without references to anything outside.

    Raises:
        BadInput: the time series is damaged.
    """
    flown, position = run.scenario, per_uav(run.table, *COLUMNS)
    uavs = parts_of(flown)
    if not np.isfinite(position).all():
        raise BadInput("positions that are not finite; bring the time series back, or fly the run again")
    goals = np.unique(state.flat(mission.all_goals(flown)), axis=0)
    view = _MapScale([position.reshape(-1, 2), goals, mission.obstacles(flown)[:, :2], mission.stations(flown)[:, :2]])
    parts = [
        *_discs(view, flown),
        *(path for part in uavs for path in _paths(view, position[:, part.rows], part.colour)),
        *_squares(view, position[0]),
        *_circles(view, position[-1], 1.8, f'fill="{plotstyle.INK}"'),
        *_circles(view, places_of(run.events, "collision", position), 3.0, f'fill="{plotstyle.STAR["color"]}"'),
        *_goals(view, goals, flown.destination.radius),
        *_triangles(view, mission.stations(flown)[:, :2]),
        *(_text(10, _MARGIN + 14 * line, part.name, part.colour) for line, part in enumerate(uavs) if part.name),
        _scale_bar(view),
    ]
    return f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img">{"".join(parts)}</svg>'


class _MapScale:
    """Map from metres to the drawing: equal scales, y upwards, centred."""

    def __init__(self, places: Iterable[Floats]) -> None:
        points = np.concatenate([part for part in places if len(part)])
        low, high = points.min(axis=0), points.max(axis=0)
        room = np.array([WIDTH - 2 * _MARGIN, HEIGHT - 2 * _MARGIN])
        self.scale = float((room / np.maximum(high - low, _LEAST_M)).min())
        self._middle = (low + high) / 2

    def __call__(self, places: Floats) -> Floats:
        """Places (..., 2), in m, to the drawing."""
        upwards = np.array([self.scale, -self.scale])
        return np.asarray((places - self._middle) * upwards + np.array([WIDTH / 2, HEIGHT / 2]))


def _paths(view: _MapScale, position: Floats, colour: str) -> list[str]:
    """The paths of positions (T, N, 2), the last tick included."""
    ticks, uavs, _ = position.shape
    step = max(1, ticks * uavs // _MOST_POINTS)
    shown = np.unique(np.append(np.arange(0, ticks, step), ticks - 1))
    lines = "".join(f"M{' '.join(map(_point, path))}" for path in view(position[shown]).transpose(1, 0, 2))
    return [f'<path d="{lines}" fill="none" stroke="{colour}" stroke-width="1" stroke-opacity=".6"/>']


def _point(place: Floats) -> str:
    return f"{place[0]:.1f} {place[1]:.1f}"


def _squares(view: _MapScale, places: Floats) -> list[str]:
    """The starts."""
    return [
        f'<rect x="{x - 1.5:.1f}" y="{y - 1.5:.1f}" width="3" height="3" fill="{plotstyle.PALE}"/>'
        for x, y in view(places[:_MOST_MARKS])
    ]


def _circles(view: _MapScale, places: Floats, radius: float, look: str) -> list[str]:
    return [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius:.1f}" {look}/>' for x, y in view(places[:_MOST_MARKS])]


def _discs(view: _MapScale, flown: FlownKeys | Scenario) -> list[str]:
    """The obstacles, to scale."""
    look = f'fill="{plotstyle.PALE}" fill-opacity=".5"'
    drawn = []
    for obstacle in flown.obstacles:
        if obstacle.polygon:
            corners = " ".join(f"{x:.1f},{y:.1f}" for x, y in view(np.array(obstacle.polygon)))
            drawn.append(f'<polygon points="{corners}" {look}/>')
        else:
            drawn += _circles(view, np.array([obstacle.centre[:2]]), obstacle.radius * view.scale, look)
    return drawn


def _triangles(view: _MapScale, places: Floats) -> list[str]:
    """The stations."""
    look = f'fill="{plotstyle.INK}"'
    return [f'<path d="M{x - 3:.1f} {y + 3:.1f}h6l-3 -6z" {look}/>' for x, y in view(places)]


def _goals(view: _MapScale, goals: Floats, radius_m: float) -> list[str]:
    """One goal as a ring to scale, several as small crosses."""
    if len(goals) == 1:
        ring = f'fill="none" stroke="{plotstyle.GOAL}" stroke-width="1.6"'
        return _circles(view, goals, max(3.0, radius_m * view.scale), ring)
    look = f'stroke="{plotstyle.GOAL}" stroke-width="1.2"'
    return [f'<path d="M{x - 2.5:.1f} {y - 2.5:.1f}l5 5m0 -5l-5 5" {look}/>' for x, y in view(goals[:_MOST_MARKS])]


def _scale_bar(view: _MapScale) -> str:
    """A bar of a round length, about a fifth of the width."""
    wanted = WIDTH / 5 / view.scale
    decade = 10.0 ** np.floor(np.log10(wanted))
    length_m = max(bar * decade for bar in _BARS if bar * decade <= wanted)
    long = length_m * view.scale
    return (
        f'<path d="M10 {HEIGHT - 10}h{long:.1f}" stroke="{plotstyle.INK}" stroke-width="1.5"/>'
        f"{_text(14 + long, HEIGHT - 6, f'{length_m:g} m', plotstyle.INK)}"
    )


def _text(x: float, y: float, words: str, colour: str) -> str:
    look = f'font-size="11" font-family="system-ui, sans-serif" fill="{colour}"'
    return f'<text x="{x:.1f}" y="{y}" {look}>{words}</text>'
