"""The world's tick, compiled. Where no compiler was at hand when meanflock was installed, it is NumPy's.

Both give the same bits. One call takes the place of some sixty of NumPy's on arrays so short that the calls are all
they cost.
"""

import math

import numpy as np
from numpy.typing import NDArray

from swarm import model, state
from swarm.scenario import Scenario

try:
    from worldsim import _kernel
except ImportError:
    _kernel = None  # type: ignore[assignment]

Floats = NDArray[np.float64]


def is_compiled() -> bool:
    """Whether this installation has the compiled form."""
    return _kernel is not None


def enter(said: list[bytes], bound: float, accelerations: Floats, diagnostics: Floats) -> tuple[float, float] | None:
    """Outcomes (N, 5), in pieces, into (N, 2) and (N, 3); returns the largest of either of the first two diagnostics.

    None, and nothing is written, where a number is not below the bound, or where there is no compiled form.
    """
    return None if _kernel is None else _kernel.enter(said, bound, accelerations, diagnostics)


def distances(columns: Floats) -> float | None:
    """What `metrics.distances` returns; None where there is no compiled form."""
    return None if _kernel is None else _kernel.distances(columns)


def near(columns: Floats, reach: float, most: float, least: float) -> tuple[int, NDArray[np.intp]] | None:
    """Of points (2, N), x ascending: how many pairs are at most so far apart, and those that are less, (K, 2), i < j;
    both squared, and neither farther apart along x than the reach. None where there is no compiled form.
    """
    if _kernel is None:
        return None
    count, touching = _kernel.near(columns, reach, most, least)
    return count, np.frombuffer(touching, np.intp).reshape(-1, 2)


def spread(models: Floats) -> float | None:
    """`summary.weight_spread` of models (N, 246) in one piece.

    None where there are none, where one is none that can be, or where there is no compiled form.
    """
    return None if _kernel is None else _kernel.spread(models, len(models), models.shape[1], model.BEYOND_SENSE)


class Kernel:
    """What `physics.Physics` says of small swarms, and of large ones all but their pairs."""

    def __init__(self, scenario: Scenario, bound: float) -> None:
        """`bound`: who is beyond it in metres or m/s has diverged."""
        wind, vehicle, metrics = scenario.wind, scenario.vehicle, scenario.metrics
        self._uavs = scenario.uavs
        self._constants = np.array(  # as in `Constants` of tick.h; rounded as in dynamics, energy and metrics
            [
                *(*wind.mean, wind.drag, scenario.dt, wind.sigma * math.sqrt(scenario.dt)),
                *(2.0 * vehicle.induced_velocity**2, vehicle.tip_speed**2),
                *(vehicle.blade_power, vehicle.induced_power, vehicle.parasite_drag),
                *(bound, scenario.destination.radius, metrics.hazard_radius**2, metrics.collision_radius**2),
            ]
        ).tobytes()

    def __call__(
        self,
        measures: bool,
        states: state.States,
        status: NDArray[np.uint8],
        accelerations: state.Plane,
        gust: state.Plane | None,
        noise: state.Plane,
        moved: state.States,
        books: tuple[Floats, Floats, Floats, NDArray[np.int64]],
        numbers: Floats,
        marks: NDArray[np.uint8],
    ) -> int:
        """One tick of as many swarms as there are states of; `measures` all pairs of each, if asked to.

        Writes into all that comes after `noise`, which must be in one piece, as `states` and `status` must; returns
        all marks there are, as one number.
        """
        return _kernel.advance(
            self._constants,
            self._uavs,
            measures,
            states,
            status,
            np.ascontiguousarray(accelerations, dtype=np.float64),
            None if gust is None else np.ascontiguousarray(gust, dtype=np.float64),
            np.ascontiguousarray(noise),
            moved,
            *books,
            numbers,
            marks,
        )
