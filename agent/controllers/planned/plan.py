"""Concurrent trajectories (Turpin, Michael and Kumar, Concurrent assignment and planning of trajectories for large
teams of robots, ICRA 2013), tracked: everybody knows them before take-off, and nobody says anything on the way.

The assignment is that of the formation: a UAV's slot is its place in it, drawn together about the goal of all. Where
goals differ, companions are those with the same goal; a UAV that has one of its own goes there.
"""

from collections.abc import Sequence
from typing import Annotated

from msgspec import Meta

from meanflock.agent.controllers import base
from meanflock.agent.controllers.base import Memory, Received, Step
from meanflock.agent.controllers.planned.base import Planned
from meanflock.agent.controllers.planned.trajectory import CRUISE_M_S
from meanflock.agent.controllers.travel import CruiseSpeed, against_the_air
from meanflock.swarm.state import States


class Plan(Planned):
    """Follows a trajectory computed before take-off, as all others do; every UAV knows all of them.

    a = a* + k_p (r* − r) + k_v (v* − v) + c0 (v − v_o). It sends nothing.
    """

    name = "plan"

    class Options(base.Options, frozen=True):
        """The options of `plan`."""

        speed_m_s: CruiseSpeed = CRUISE_M_S
        position_gain_1_s2: Annotated[float, Meta(gt=0, description="k_p, 1/s²")] = 4.0
        velocity_gain_1_s: Annotated[float, Meta(gt=0, description="k_v, 1/s")] = 4.0

    def step(self, memory: Memory, tick: int, own: States, received: Sequence[Received]) -> Step:
        of = self.options
        off, acceleration = self._off(memory["uav"], tick, own)
        acceleration = acceleration - of.position_gain_1_s2 * off[..., 0] - of.velocity_gain_1_s * off[..., 1]
        return Step(memory, acceleration + against_the_air(self.scenario, own))
