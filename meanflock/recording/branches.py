"""The branches of a recording that draw a flight: the map, which shows it from above, and space, in three dimensions.

Both have the same entities. A branch has their paths, and Rerun's types for its number of axes.
"""

from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray

from meanflock.recording import drawing
from meanflock.recording.drawing import Floats
from meanflock.swarm import state


class Branch:
    """Paths of the entities below `root`, and the types of points, arrows and lines there.

    axes: 2 or 3. marks: entity of each kind of event that has a mark.
    """

    def __init__(self, root: str, axes: int) -> None:
        self.root, self.axes = root, axes
        self.uavs, self.velocity, self.trails = f"{root}/uavs", f"{root}/velocity", f"{root}/trails"
        self.model_links, self.leader = f"{root}/links/models", f"{root}/leader"
        self.marks = {
            "collision": f"{root}/collisions",
            "hit": f"{root}/obstacle_hits",
            "grounded": f"{root}/groundings",
        }
        suffix = f"{axes}D"
        points, arrows = getattr(rr, f"Points{suffix}"), getattr(rr, f"Arrows{suffix}")
        lines = getattr(rr, f"LineStrips{suffix}")
        self.points, self.point_colors = points.descriptor_positions(), points.descriptor_colors()
        self.vectors, self.origins = arrows.descriptor_vectors(), arrows.descriptor_origins()
        self.strips, self.strip_colors = lines.descriptor_strips(), lines.descriptor_colors()
        self._position = getattr(rr.components, f"Position{suffix}Batch")
        self._vector = getattr(rr.components, f"Vector{suffix}Batch")
        self._line = getattr(rr.components, f"LineStrip{suffix}Batch")

    def within(self, vectors: NDArray[Any]) -> NDArray[Any]:
        """The parts of vectors along the axes of the branch, `(..., axes)`, a view."""
        return vectors[..., : self.axes]

    def places(self, points: Floats) -> Any:
        """A batch of positions `(..., axes)`, m."""
        return self._position(points.reshape(-1, self.axes))

    def arrows(self, vectors: Floats) -> Any:
        """A batch of vectors `(..., axes)`."""
        return self._vector(vectors.reshape(-1, self.axes))

    def lines(self, points: Floats) -> Any:
        """K lines of P points each, (K, P, axes), m; Rerun itself would make them one by one."""
        kind = self._line._ARROW_DATATYPE
        count, each, _ = points.shape
        flat = pa.FixedSizeListArray.from_arrays(points.reshape(-1), type=kind.value_type)
        offsets = np.arange(0, count * each + 1, each, dtype=np.int32)
        return self._line(pa.ListArray.from_arrays(offsets, flat, type=kind))


class Mark(NamedTuple):
    """The mark of a kind of event: a line of radius 1 around the origin on the map and in space, colour and thickness
    in points.
    """

    on_map: NDArray[np.float64]
    in_space: NDArray[np.float64]
    color: int
    thickness: float


def _spokes(ends: NDArray[np.float64]) -> NDArray[np.float64]:
    """A line through the origin to each of the `ends` (K, 3) and to its opposite, of radius 1."""
    ends = ends / np.linalg.norm(ends, axis=-1, keepdims=True)
    return np.stack([-ends, ends, 0.0 * ends], axis=1).reshape(-1, 3)


_DIAGONALS = np.array([(1, 1, 1), (1, -1, 1), (-1, 1, 1), (-1, -1, 1)])
MARK_M = 1.4  # radius of a mark
MARKS = {
    "collision": Mark(drawing.STAR, _spokes(np.eye(3)), drawing.COLLISION, 1.2),
    "hit": Mark(drawing.CROSS, _spokes(_DIAGONALS), drawing.HIT, 1.5),
    "grounded": Mark(-drawing.TRIANGLE, state.in_three(-drawing.TRIANGLE), drawing.GROUNDED, 1.5),
}

ON_MAP = Branch("map", state.PLANE)
IN_SPACE = Branch("space", state.SPACE)
