"""Map of the wind in a corridor: posterior mean at its nodes, from few and noisy measurements.

The wind between nodes is interpolated bilinearly, so a measurement counts for four nodes, each with its share φ.
Measurements are stored as additive information at each node: λ = Σ φ/R and η = Σ φ w/R (the matrix Σ φφᵀ/R with its
rows summed on the diagonal). The prior is a Gaussian field with a rational quadratic kernel. The posterior mean is
K (1 + ΛK)⁻¹ η (Rasmussen and Williams 2006, 2.25, in the form without an inverse).
"""

import math

import numpy as np
from numpy.typing import NDArray

from meanflock.agent.controllers.elimination import product, solve
from meanflock.swarm.state import Floats

INFORMATION = 3  # η along x and y, and λ
MOST_NODES = 1000  # of a map; its matrix takes 8 MB a UAV


class WindGrid:
    """Nodes along a corridor, and the prior of the wind at them.

    Attributes:
        nodes: (F, 2) m, their positions. count: F.
    """

    def __init__(
        self, origin: Floats, along: Floats, length_m: float, width_m: float, spacing_m: float, rms: float, scale: float
    ) -> None:
        """Args:
        origin: (2,) one end of the corridor's middle. along: (2,) unit vector towards the other end. width_m: from the
            middle to each side. spacing_m: largest distance of nodes. rms: m/s, of each component of the wind.
            scale: m, correlation length of the wind.

        Raises:
            ValueError: there would be too many nodes.
        """
        self._origin, self._along = origin, along
        self._across = np.array([-along[1], along[0]])
        self._shape = tuple(max(1, math.ceil(extent / spacing_m)) for extent in (length_m, 2.0 * width_m))
        self._steps = (length_m / self._shape[0], 2.0 * width_m / self._shape[1])
        self._width = width_m
        columns, rows = (count + 1 for count in self._shape)
        if columns * rows > MOST_NODES:
            raise ValueError(
                f"a map of {columns} × {rows} nodes; at most {MOST_NODES}: raise `spacing_m` or lower `width_m`"
            )
        self._columns = columns
        first, second = np.divmod(np.arange(columns * rows), columns)[::-1]
        self.nodes = (
            origin
            + (first * self._steps[0])[:, None] * along
            + (second * self._steps[1] - width_m)[:, None] * self._across
        )
        self.count = len(self.nodes)
        apart = ((self.nodes[:, None] - self.nodes[None]) ** 2).sum(axis=-1)
        near = 1.0 + apart / (4.0 * scale * scale)
        self._prior = rms * rms / (near * near)

    def shares(self, places: Floats) -> tuple[NDArray[np.intp], Floats]:
        """The four nodes around places (…, 2) m and their shares, both (…, 4); beyond the edge those of the edge."""
        off = places - self._origin
        first = off[..., 0] * self._along[0] + off[..., 1] * self._along[1]
        second = off[..., 0] * self._across[0] + off[..., 1] * self._across[1] + self._width
        cells, parts = [], []
        for distance, step, count in (
            (first, self._steps[0], self._shape[0]),
            (second, self._steps[1], self._shape[1]),
        ):
            within = np.clip(distance / step, 0.0, count)
            cell = np.minimum(within.astype(np.intp), count - 1)
            cells.append(cell)
            parts.append(within - cell)
        corner = cells[1] * self._columns + cells[0]
        (u, v), row = parts, self._columns
        which = np.stack([corner, corner + 1, corner + row, corner + row + 1], axis=-1)
        share = np.stack([(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v], axis=-1)
        return which, share

    def at(self, maps: Floats, places: Floats) -> Floats:
        """The wind of maps (M, F, 2) at places (M, …, 2): (M, …, 2) m/s."""
        which, share = self.shares(places)
        row = np.arange(len(maps)).reshape(-1, *(1,) * (which.ndim - 1))
        corners = maps[row, which] * share[..., None]
        return corners[..., 0, :] + corners[..., 1, :] + (corners[..., 2, :] + corners[..., 3, :])

    def informed(self, rows: NDArray[np.intp], places: Floats, wind: Floats, precision: Floats, count: int) -> Floats:
        """Information (count, F, 3) of measurements by `rows` (L,), summed in their order.

        Args:
            places, wind: (L, 2), m and m/s. precision: (L,), 1/R, s²/m².
        """
        which, share = self.shares(places)
        one = np.ones((len(rows), 1))
        weighted = np.concatenate([wind, one], axis=1)[:, None] * (share * precision[:, None])[..., None]
        information = np.zeros((count, self.count, INFORMATION))
        np.add.at(information, (rows[:, None], which), weighted)
        return information

    def mean(self, information: Floats, base: Floats | None = None) -> Floats:
        """The wind at the nodes, (M, F, 2) m/s, given information (M, F, 3).

        Args:
            base: (M, F, 2), the prior mean; None for zero.
        """
        weight = information[..., -1:]
        innovation = information[..., :-1] if base is None else information[..., :-1] - weight * base
        system = np.eye(self.count) + weight * self._prior
        deviation = product(self._prior, solve(system, innovation))
        return deviation if base is None else base + deviation
