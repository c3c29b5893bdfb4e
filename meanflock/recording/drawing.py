"""The elements of a recording: colours, shapes, fixed marks, and columns of values.

Colours are 0xRRGGBBAA. A column holds one component of an entity, a row a tick, in the form in which Rerun sends it.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray

Point = tuple[float, float]
Ticks = NDArray[np.int64]
Floats = NDArray[np.float32]
Colors = NDArray[np.uint32]
Sent = tuple[str, Ticks, list[rr.ComponentColumn]]  # entity, ticks (R,), columns of R rows

_SCALARS = rr.Scalars.descriptor_scalars()

# Shapes around the origin, of radius 1, as one line each: (points, 2).
_CORNERS = np.arange(11) * (math.pi / 5) + math.pi / 2
STAR = np.stack([np.cos(_CORNERS), np.sin(_CORNERS)], axis=-1) * np.where(np.arange(11) % 2, 0.4, 1.0)[:, None]
TRIANGLE = np.array([(-0.9, -1.0), (0.9, -1.0), (0.0, 1.0), (-0.9, -1.0)])
CROSS = np.array([(-1.0, -1.0), (1.0, 1.0), (0.0, 0.0), (-1.0, 1.0), (1.0, -1.0)]) * math.sqrt(0.5)

# Readers with any common colour vision can tell delivered messages from outages, and the lines of a plot.
BLUE = 0x5AA9E6FF
ORANGE = 0xF4A259FF
GREEN = 0x35D6A0FF
RED = 0xF2552CFF
VIOLET = 0x8B5CF6FF
WHITE = 0xECEFF4FF
GREY = 0x8A93A6FF
PINK = 0xFF7AC6FF
ICE = 0x8FE9FFFF
COLLISION = PINK
HIT = 0xBBFFBBFF  # no group, gust or link has it
GROUNDED = VIOLET
HEAD = BLUE
STATION = WHITE
LINES = (ORANGE, BLUE, GREEN, VIOLET, WHITE, GREY, RED, PINK, ICE)  # of a plot, in this order, then from the start
GROUPS = (BLUE, 0xFFB454FF, 0xB99AFFFF, 0xE6E65AFF, 0xFF8FA3FF, WHITE)  # of the groups of a flight, in their order
DISC, BREEZE = 0x3A4150FF, 0xF4A25966  # an obstacle; the wind at a place
FROZEN = ICE
CUT = RED  # faults of the radio have the colour of outages
JAMMED = RED
GUST = ORANGE

PHI_G_LOW, PHI_G_HIGH = 1e-3, 1.0  # ends of the logarithmic colour scale of φ_G, 1/s²
SPEED_HIGH = 5.0  # upper end of the colour scale of speed, which begins at 0, m/s
# Viridis at even steps, without its first eighth, which is too dark for the canvas.
_VIRIDIS = np.array(
    [
        (84, 62, 150),
        (64, 90, 150),
        (44, 114, 142),
        (33, 145, 140),
        (40, 174, 128),
        (94, 201, 98),
        (173, 220, 48),
        (253, 231, 37),
    ],
    dtype=np.float64,
)

_STEPS = np.linspace(0.0, 1.0, len(_VIRIDIS))
# Of red, green and blue: the slope after each step, and the value there.
_CHANNELS = [(np.append(np.diff(base) / np.diff(_STEPS), 0.0), base) for base in _VIRIDIS.T.copy()]


def viridis(share: NDArray[np.float64]) -> Colors:
    """RGBA colours, shape `(...)`, of numbers, clipped to [0, 1]."""
    share = np.clip(share, 0.0, 1.0, dtype=np.float64)
    step = (share * (len(_VIRIDIS) - 1)).astype(np.intp)  # steps are even, so no search
    share -= _STEPS[step]
    color = np.full(share.shape, 0xFF, dtype=np.uint32)
    for bits, (slope, base) in zip((24, 16, 8), _CHANNELS, strict=True):
        color |= (slope[step] * share + base[step]).astype(np.uint32) << bits
    return color


def phi_g_colors(phi_g: NDArray[np.float32]) -> Colors:
    """RGBA colours, shape `(...)`, of φ_G ≥ 0 on the logarithmic scale that the map's legend shows."""
    low, high = math.log10(PHI_G_LOW), math.log10(PHI_G_HIGH)
    return viridis((np.log10(np.maximum(phi_g, PHI_G_LOW)) - low) / (high - low))


def speed_colors(speed_m_s: NDArray[Any]) -> Colors:
    """RGBA colours, shape `(...)`, of speeds on the linear scale that the map's legend shows."""
    return viridis(speed_m_s / SPEED_HIGH)


def group_color(number: int) -> int:
    """RGBA colour of a group by its number; the colours begin again after the last."""
    return GROUPS[number % len(GROUPS)]


def rgba(colors: Sequence[int]) -> Colors:
    """Colours in the type that Rerun does not take for channels, as it does with three or four whole numbers."""
    return np.array(colors, dtype=np.uint32)


def dimmed(colors: Colors) -> Colors:
    """RGBA colours at half their brightness: those of UAVs on the ground."""
    return (colors >> np.uint32(1)) & np.uint32(0x7F7F7F00) | np.uint32(0xFF)


def circle(centre: Point, radius: float) -> NDArray[np.float64]:
    """A closed line around a centre, (65, 2), m."""
    angle = np.linspace(0.0, 2.0 * math.pi, 65)
    return np.array(centre) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


class Part:
    """The part of a recording that shows one flight: logs marks that do not move.

    prefix: of all its entities, ends in `/`; empty where the flight has the whole recording.
    """

    def __init__(self, stream: rr.RecordingStream, prefix: str) -> None:
        self._stream, self._prefix = stream, prefix

    def log(self, entity: str, components: rr.AsComponents) -> None:
        """Logs components of an entity, for all times."""
        self._stream.log(self._prefix + entity, components, static=True)

    def line(self, entity: str, points: NDArray[np.float64], color: int, thickness: float) -> None:
        """Logs a line through `points` (K, 2), m; `thickness` in points."""
        radii = rr.Radius.ui_points(thickness)
        self.log(entity, rr.LineStrips2D([points], colors=[color], radii=radii, draw_order=1.0))

    def dots(self, entity: str, places: NDArray[np.float64], color: int, size: float) -> None:
        """Logs dots at `places` (K, 2), m; `size` in points."""
        radii = rr.Radius.ui_points(size)
        self.log(entity, rr.Points2D(places, colors=[color], radii=radii, draw_order=1.0))

    def label(self, entity: str, at: Point, text: str, color: int) -> None:
        """Logs text centred below the point `at`, m."""
        self.log(entity, rr.Points2D([at], labels=[text], colors=[color], radii=0.0, show_labels=True))


def cut(rows: int, *parts: tuple[rr.ComponentDescriptor, rr.ComponentBatchLike]) -> list[rr.ComponentColumn]:
    """Columns of so many rows, each with an equal share of all values.

    Rerun's own archetypes cut the values one by one first, which takes longer than to send them.
    """
    columns = []
    for descriptor, batch in parts:
        each = len(batch.as_arrow_array()) // rows  # 0: nothing to show, as in a round without a delivered upload
        offsets = np.arange(rows + 1, dtype=np.int32) * np.int32(each)
        columns.append(rr.ComponentColumn(descriptor, batch, offsets=offsets))
    return columns


def scalars(plot: str, ticks: Ticks, values: NDArray[Any]) -> Iterator[Sent]:
    """The lines of a plot at ticks (R,), `values` being (R,) or (R, lines); nothing where R is 0."""
    if len(ticks):
        batch = rr.components.ScalarBatch(pa.array(values.reshape(-1).astype(np.float64, copy=False)))
        yield plot, ticks, cut(len(ticks), (_SCALARS, batch))
