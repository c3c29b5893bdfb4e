"""Names beside the points of a plot, where there is room: none covers another, or a point."""

import math
from collections.abc import Iterator, Sequence

from matplotlib.axes import Axes
from matplotlib.transforms import Bbox

Named = tuple[str, float, float, str, bool]  # name, x, y, colour, whether it stands out

_SIZE, _LARGE = 6.8, 8.5  # points
_POINT_PX = 9.0  # half a side of the square a point takes
_LEADER = {"arrowstyle": "-", "linewidth": 0.5, "shrinkB": 3, "alpha": 0.7}
_RINGS, _DIRECTIONS = 14, 16  # places that are tried around a point


def label(ax: Axes, named: Sequence[Named]) -> None:
    """Writes the names; the plot's limits and size are those it keeps, and it has been laid out."""
    figure = ax.get_figure(root=True)
    assert figure is not None
    renderer = figure.canvas.get_renderer()  # type: ignore[attr-defined]
    frame = ax.get_window_extent(renderer)
    places = [ax.transData.transform((x, y)) for _, x, y, _, _ in named]
    taken = [Bbox.from_extents(x - _POINT_PX, y - _POINT_PX, x + _POINT_PX, y + _POINT_PX) for x, y in places]
    for (name, _, _, tone, large), (x, y) in sorted(zip(named, places, strict=True), key=lambda one: -one[1][1]):
        text = ax.annotate(
            name, (x, y), xycoords="figure pixels", xytext=(x, y), textcoords="figure pixels", color=tone,
            fontsize=_LARGE if large else _SIZE, fontweight="bold" if large else "normal", ha="left", va="center",
            annotation_clip=False, zorder=6,
        )  # fmt: skip
        size = text.get_window_extent(renderer)
        text.remove()
        for left, low in _around(x, y, size.width, size.height):
            box = Bbox.from_bounds(left, low, size.width, size.height)
            inside = frame.x0 <= box.x0 and box.x1 <= frame.x1 and frame.y0 <= box.y0 and box.y1 <= frame.y1
            if inside and not any(box.overlaps(other) for other in taken):
                break
        else:
            box = Bbox.from_bounds(x, y, size.width, size.height)
        taken.append(box)
        far = math.hypot(max(box.x0 - x, 0, x - box.x1), max(box.y0 - y, 0, y - box.y1)) > 2.2 * _POINT_PX
        to_data = ax.transData.inverted().transform
        ax.annotate(
            name, tuple(to_data((x, y))), xytext=tuple(to_data((box.x0, (box.y0 + box.y1) / 2))), color=tone,
            textcoords="data", fontsize=_LARGE if large else _SIZE, fontweight="bold" if large else "normal",
            ha="left", va="center", zorder=6,
            arrowprops={**_LEADER, "color": tone} if far else None,
        )  # fmt: skip


def _around(x: float, y: float, width: float, height: float) -> Iterator[tuple[float, float]]:
    """Left lower corners of boxes around a point, near ones first."""
    for ring in range(_RINGS):
        gap = _POINT_PX + 2.0 + 7.0 * ring
        for turn in range(_DIRECTIONS):
            angle = 2.0 * math.pi * turn / _DIRECTIONS
            middle_x = x + math.cos(angle) * (gap + width / 2)
            middle_y = y + math.sin(angle) * (gap + height / 2)
            yield middle_x - width / 2, middle_y - height / 2
