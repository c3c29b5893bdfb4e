"""The terms of the reward of a tick, one number for each UAV."""

from collections.abc import Mapping

import numpy as np

from meanflock.swarm import mission, state
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats, Mask, Rows, States, Vectors, norm

WEIGHTS = {
    "progress": 1.0,  # by how much the UAV came nearer to its goal, m
    "arrival": 20.0,  # 1 in the tick in which it arrives
    "time": -0.1,  # duration of the tick while it is on the way, s
    "effort": -0.05,  # ‖a‖² of its command times the duration of the tick, m²/s³
    "collision": -5.0,  # number of other UAVs with which it collides for the first time
    "loss": -50.0,  # 1 in the tick in which it is lost
}
TERMS = tuple(WEIGHTS)


def weights_of(given: Mapping[str, float] | None) -> Rows:
    """The weights of the terms, in their order; raises BadInput if a name or a number cannot be used."""
    try:
        named = WEIGHTS | dict(given or {})
    except (TypeError, ValueError):
        raise BadInput(f"reward: {given!r}; give a dict of terms and weights, as of {', '.join(TERMS)}") from None
    if unknown := [name for name in named if name not in TERMS]:
        raise BadInput(f"reward: there is no term {unknown[0]!r}; there are {', '.join(TERMS)}")
    try:
        weights = np.array([float(named[name]) for name in TERMS])
    except (TypeError, ValueError) as error:
        raise BadInput(f"reward: {error}; give numbers") from error
    if not np.isfinite(weights).all():
        raise BadInput("reward: a weight is not finite")
    return weights


class Terms:
    """Computes the terms of one flight after each tick."""

    def __init__(self, scenario: Scenario) -> None:
        self._goals = mission.goals(scenario)
        self._dt = scenario.dt
        self._collided: set[tuple[int, int]] = set()
        self._distance = self._to_goal(mission.starts(scenario))

    def after(
        self, states: States, command: Vectors, on_way: Mask, arrived: Mask, lost: Mask, collided: set[tuple[int, int]]
    ) -> Floats:
        """The terms of a tick, (N, 6).

        Args:
            states: (N, 4), after the tick. command: (N, 2). on_way: UAVs that were on the way before it. arrived,
            lost: UAVs that arrived or were lost in it. collided: all pairs that have collided.
        """
        terms = np.zeros((len(states), len(TERMS)))
        distance = self._to_goal(states)
        terms[:, 0] = np.where(on_way, self._distance - distance, 0.0)
        self._distance = distance
        terms[:, 1] = arrived
        terms[:, 2] = self._dt * on_way
        squared = command * command
        terms[:, 3] = np.where(on_way & ~lost, squared.sum(axis=1) * self._dt, 0.0)
        if len(collided) > len(self._collided):
            for pair in collided - self._collided:
                terms[list(pair), 4] += 1.0
            self._collided = set(collided)
        terms[:, 5] = lost
        return terms

    def _to_goal(self, states: States) -> Rows:
        return norm(state.position(states) - state.position(self._goals))
