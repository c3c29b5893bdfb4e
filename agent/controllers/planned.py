"""What controllers have in common that follow trajectories which everybody knows before take-off, and say nothing."""

from functools import cached_property

from meanflock.agent.controllers.base import Controller
from meanflock.agent.controllers.trajectory import Trajectory
from meanflock.agent.prediction import AlongPlan
from meanflock.swarm import mission


class Planned(Controller):
    """Base class of them; the cruise speed is their option `speed_m_s`."""

    broadcast_numbers = 0

    @cached_property
    def _trajectory(self) -> Trajectory:
        return Trajectory(self.scenario, mission.starts(self.scenario), self.options.speed_m_s)

    def prediction(self) -> AlongPlan:
        """How others expect a UAV to go on that is off its trajectory: it comes back to it."""
        return AlongPlan(self._trajectory.states, self.scenario.dt)
