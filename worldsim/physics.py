"""One tick of the world: everybody moves, pays for it and may arrive or diverge, and all pairs are measured.

Of one swarm, or of many side by side. What an incident means, and what is kept of a tick, is the flight's.
"""

from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from swarm import state
from swarm.messages import Status
from swarm.scenario import Scenario
from worldsim import dynamics, energy
from worldsim.kernel import Kernel, is_compiled
from worldsim.metrics import FEW, Pairs, few, many, pairs

Floats: TypeAlias = NDArray[np.float64]
Marks: TypeAlias = NDArray[np.uint8]

# What is added up of every UAV, each (..., N): energy, J; and of who is on the way: distance, m; speed, m/s over ticks;
# ticks. A tick writes into these arrays.
Books: TypeAlias = tuple[Floats, Floats, Floats, NDArray[np.int64]]

# As numbers of the array they are compared with: a member of an enumeration is converted anew each time.
FLYING, ARRIVED, LOST = np.uint8(Status.FLYING), np.uint8(Status.ARRIVED), np.uint8(Status.LOST)
BOUND = 1e9  # a million kilometres or km/s: no metric is left worth having
DIVERGED, ARRIVING, COLLIDING = 1, 2, 4  # marks of a UAV


class Moved(NamedTuple):
    """What a tick did, beside the books.

    states: (..., N, 4), a new array.
    numbers: (..., 3): the highest speed of who was on the way, m/s; then speed_difference and near of `Pairs`.
    incidents: whether anybody is marked; if not, the marks need not be read.
    marks: (..., N): DIVERGED, left every bound and was put back, at rest; ARRIVING, was on the way and is there.
    colliding: as of `Pairs`, but pairs that are not both on the way may be missing.
    """

    states: state.States
    numbers: Floats
    incidents: int
    marks: Marks
    colliding: NDArray[np.intp]


class Physics:
    """The tick of a scenario; N is its number of UAVs, leading axes are free."""

    def __init__(self, scenario: Scenario, *, compiled: bool = True) -> None:
        """`compiled`: with the compiled kernel, if this installation has it; the bits are the same."""
        self._scenario = scenario
        self._kernel = Kernel(scenario, BOUND) if compiled and is_compiled() else None

    def __call__(
        self,
        states: state.States,
        status: Marks,
        accelerations: state.Plane,
        gust: state.Plane | None,
        noise: state.Plane,
        books: Books,
    ) -> Moved:
        """One tick; a swarm's numbers do not depend on those beside it.

        Args:
            states: (..., N, 4). status: (..., N). books: of these, written into.
            accelerations: (..., N, 2), m/s²; lost UAVs get none, whatever is asked.
            gust: (..., N, 2), m/s², of the air: it spares nobody. noise: (..., N, 2), standard normal.
        """
        if self._kernel is None:
            return self._in_numpy(states, status, accelerations, gust, noise, books)
        small = states.shape[-2] <= FEW
        moved, numbers, marks = np.empty(states.shape), np.empty((*states.shape[:-2], 3)), np.empty_like(status)
        incidents = self._kernel(small, states, status, accelerations, gust, noise, moved, books, numbers, marks)
        if not small:
            colliding = _enter(many(self._scenario.metrics, moved), numbers)
        elif incidents & COLLIDING:
            colliding = self._colliding(moved, marks)
        else:
            colliding = _NOBODY
        return Moved(moved, numbers, incidents, marks, colliding)

    def _in_numpy(
        self,
        states: state.States,
        status: Marks,
        accelerations: state.Plane,
        gust: state.Plane | None,
        noise: state.Plane,
        books: Books,
    ) -> Moved:
        scenario, (spent, distance, speed_sum, ticks_on_way) = self._scenario, books
        on_way, marks, incidents = status == FLYING, np.zeros(status.shape, dtype=np.uint8), 0
        all_on_way = np.count_nonzero(on_way) == on_way.size
        if not all_on_way:
            accelerations = np.where((status != LOST)[..., None], accelerations, 0.0)
        with np.errstate(over="ignore", invalid="ignore"):
            moved = dynamics.step(scenario, states, accelerations if gust is None else accelerations + gust, noise)
            size = np.abs(moved)
        if not np.maximum.reduce(size, axis=None) < BOUND:  # NaN is below nothing
            insane = ~(size < BOUND).all(axis=-1)
            moved[insane] = states[insane]
            moved[insane, state.VELOCITY] = 0.0
            marks[insane], incidents = DIVERGED, int(DIVERGED)
        speed = state.speed(moved)
        spent += energy.power(scenario.vehicle, speed) * scenario.dt
        on_their_way = speed if all_on_way else np.where(on_way, speed, 0.0)
        speed_sum += on_their_way
        ticks_on_way += on_way
        distance += on_their_way * scenario.dt
        within = state.norm(moved) <= scenario.destination.radius
        if np.count_nonzero(within):
            within &= on_way & (marks == 0)
            marks[within] = ARRIVING
            incidents |= int(ARRIVING) * bool(within.any())
        numbers = np.empty((*states.shape[:-2], 3))
        numbers[..., 0] = np.maximum.reduce(on_their_way, axis=-1)
        colliding = _enter(pairs(scenario.metrics, moved), numbers)
        return Moved(moved, numbers, incidents, marks, colliding)

    def _colliding(self, moved: state.States, marks: Marks) -> NDArray[np.intp]:
        """Who: the kernel says only whether somebody does, which is rare."""
        if moved.ndim == 2:
            return few(self._scenario.metrics, moved).colliding
        where = np.nonzero((marks & COLLIDING).any(axis=-1))
        found = few(self._scenario.metrics, moved[where]).colliding
        return np.column_stack([*(axis[found[:, 0]] for axis in where), found[:, 1:]])


_NOBODY = np.empty((0, 2), dtype=np.intp)


def _enter(seen: Pairs, numbers: Floats) -> NDArray[np.intp]:
    numbers[..., 1], numbers[..., 2] = seen.speed_difference, seen.near
    return seen.colliding
