"""Commands of a flight: what the UAVs do, and the diagnostics that came with it."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from meanflock import kernels
from meanflock.swarm import state
from meanflock.swarm.state import BEYOND_SENSE, NO_UAV, Floats, Mask
from meanflock.swarm.stateful import Stateful
from meanflock.worldsim.books import block_ticks, sums


class Commands(Stateful):
    """The current command of each UAV, and the diagnostics of the flight.

    Diagnostics are added up for a block of ticks at once, in the order of the ticks.

    Attributes:
        accelerations: (N, 2), m/s². The row of a UAV without a reply stays.
        diagnostics: (N, K), of the last tick. The row of a UAV without a reply is 0.
        largest: (K,), maximum of |diagnostics| over the ticks that were settled.
        summed: (K,), sum of the diagnostics of UAVs on the way over these ticks. of_groups: (G, K), the same of each
            group of the flight.
        busy: (N,), UAVs that trained in the last tick. busy_ticks: (N,), ticks in which each UAV trained.
        measured_ticks: number of ticks in which UAVs on the way had the numbers of a training, summed over UAVs.
    """

    stored = ("accelerations", "largest", "summed", "of_groups", "busy", "busy_ticks", "measured_ticks")

    def __init__(
        self,
        uavs: int,
        axes: int,
        diagnostics: int,
        busy: int | None = None,
        measured: Sequence[int] = (),
        has: Mask | None = None,
        groups: Sequence[slice] = (),
    ) -> None:
        """
        Args:
            busy: column of the diagnostics that is 1 while a UAV trains; None: none does.
            measured: columns of trainings, which a UAV has while the last of them is above 0.
            has: (N, K), the diagnostics that each UAV has; those that it has not are 0. None: every UAV has all.
            groups: the rows of each group.
        """
        self._has, self._groups = has, groups
        self._busy, self._measured = busy, list(measured)
        self.busy: Mask = np.zeros(uavs, dtype=bool)
        self.busy_ticks = np.zeros(uavs, dtype=np.int64)
        self.measured_ticks = 0
        self.accelerations: state.Vectors = np.zeros((uavs, axes))
        self.diagnostics: Floats = np.zeros((uavs, diagnostics))
        self._most = block_ticks(uavs)
        self.largest: Floats = np.zeros(diagnostics)
        self.summed: Floats = np.zeros(diagnostics)
        self.of_groups: Floats = np.zeros((len(groups), diagnostics))
        self._block: list[Floats] = []  # diagnostics of ticks that are not in the sums yet
        self._on_way: Mask = np.zeros(uavs, dtype=bool)  # in these ticks

    def store(self, numbers: Floats, replied: Mask, awake: Mask, on_way: Mask) -> NDArray[np.intp]:
        """Store the numbers (N, 2 + K) of the UAVs that replied and are awake.

        Args:
            numbers: of the replies, finite; never written to again.
            replied: (N,), UAVs whose node replied.
            awake: (N,), UAVs that take part in the tick.
            on_way: (N,), UAVs that have left the ground, have not arrived and are not lost; a new array if others have.

        Returns:
            The UAVs that replied with a diverged number; their rows are not stored.
        """
        stored, axes = replied & awake, self.accelerations.shape[1]
        diverged = NO_UAV
        if b"\0" in stored.tobytes() or not kernels.largest(numbers) < BEYOND_SENSE:
            bounded = np.logical_and.reduce(np.abs(numbers) < BEYOND_SENSE, axis=1)
            stored &= bounded
            diverged = np.flatnonzero(replied & ~bounded)
            np.copyto(self.accelerations, numbers[:, :axes], where=stored[:, None])
            numbers = np.where(stored[:, None], numbers, 0.0)
        else:
            self.accelerations[...] = numbers[:, :axes]
        self.diagnostics = numbers[:, axes:]
        if self._busy is not None:
            self.busy = self.diagnostics[:, self._busy] > 0.0
            self.busy_ticks += self.busy
        if on_way is not self._on_way or len(self._block) == self._most:
            self.settle()
            self._on_way = on_way
        self._block.append(self.diagnostics)
        return diverged

    def means(self, uavs: Mask) -> list[float | None]:
        """Means of the diagnostics of the last tick over some UAVs (N,), of those that have them; None for no UAV."""
        trained = self.diagnostics[:, self._measured[-1:]] > 0.0  # (N, 1), or (N, 0) without trainings
        if self._has is None and trained[uavs].all():
            counted = self.diagnostics[uavs]
            return list(counted.mean(axis=0).tolist()) if len(counted) else [None] * counted.shape[1]
        counts = np.tile(uavs[:, None], self.diagnostics.shape[1])
        counts[:, self._measured] &= trained
        if self._has is not None:
            counts &= self._has
        columns = [numbers[counted] for numbers, counted in zip(self.diagnostics.T, counts.T, strict=True)]
        return [float(column.mean()) if len(column) else None for column in columns]

    def ticks(self, ticks: NDArray[np.int64]) -> list[int]:
        """Of so many ticks on the way of each UAV (N,), those in which it had each diagnostic, summed; K of them."""
        columns = self.diagnostics.shape[1]
        found = [int(ticks.sum())] * columns if self._has is None else (ticks @ self._has).tolist()
        return [self.measured_ticks if column in self._measured else found[column] for column in range(columns)]

    def settle(self) -> None:
        """Add the diagnostics of the ticks since the last call to the sums."""
        if not self._block:
            return
        block = np.stack(self._block)  # (k, N, K)
        self._block = []
        sizes = np.abs(block.transpose(2, 0, 1), order="C")  # much faster than a maximum along few columns
        self.largest = np.maximum(self.largest, np.maximum.reduce(sizes, axis=(1, 2)))
        on_way = block.take(self._on_way.nonzero()[0], axis=1)
        self.measured_ticks += int(np.count_nonzero(on_way[..., self._measured[-1:]] > 0.0))
        of_ticks = np.add.reduce(on_way, axis=1)
        self.summed = sums(self.summed, of_ticks)[-1]
        for number, rows in enumerate(self._groups):
            of_ticks = np.add.reduce(block[:, rows][:, self._on_way[rows]], axis=1)
            self.of_groups[number] = sums(self.of_groups[number], of_ticks)[-1]
