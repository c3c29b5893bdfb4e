"""Energy and time on the air that radios and computers of the nodes have consumed so far."""

import numpy as np

from meanflock.channel.medium import Medium
from meanflock.federation.plan import Plan
from meanflock.federation.seat import ticks_until_lost
from meanflock.swarm import mission
from meanflock.swarm.state import Floats
from meanflock.worldsim.commands import Commands
from meanflock.worldsim.flight import Flight


class Consumption:
    """Energy and air time of N UAVs and B stations, from what the parts of a world have counted; it keeps nothing."""

    def __init__(self, plan: Plan, flight: Flight, air: Medium, commands: Commands) -> None:
        self._plan, self._scenario = plan, plan.scenario
        self._flight, self._air, self._commands = flight, air, commands
        self._training_W = np.full(self._scenario.uavs, self._scenario.training.power_W)
        for group, rows in mission.parts(self._scenario):
            if group.training is not None:
                self._training_W[rows] = group.training.power_W

    @property
    def radio_J(self) -> Floats:
        """Energy of the radio of each node so far, (N + B,): of sending, receiving and neither, J."""
        scenario, flight = self._scenario, self._flight
        sends_s, _, receives_s = scenario.radio.coherence_time_s * self._air.meter.loads
        powered = np.append(flight.tick - flight.off_ticks, np.minimum(flight.tick, ticks_until_lost(scenario)))
        idles_s = np.maximum(0.0, powered * scenario.dt - sends_s - receives_s)
        constants = scenario.energy
        energy: Floats = constants.radio_W * sends_s + constants.receive_W * receives_s + constants.idle_W * idles_s
        return energy

    @property
    def compute_J(self) -> Floats:
        """Energy of the computer of each UAV so far, (N,), J."""
        scenario, flight = self._scenario, self._flight
        ticks = flight.tick - flight.off_ticks
        energy: Floats = scenario.energy.step_J * ticks + scenario.dt * self._training_W * self._commands.busy_ticks
        return energy

    @property
    def of_uavs_J(self) -> Floats:
        """Energy of each UAV so far, (N,), J: of motion, radio and computer."""
        energy: Floats = self._flight.energy + self.radio_J[: self._scenario.uavs] + self.compute_J
        return energy

    @property
    def duty(self) -> Floats:
        """Share of the time so far in which each node sends, (N + B,); the time is one round at least."""
        scenario = self._scenario
        sends_s = scenario.radio.coherence_time_s * self._air.meter.loads[0]
        share: Floats = sends_s / (scenario.dt * max(1, self._flight.tick, self._plan.period_ticks))
        return share

    def totals(self) -> dict[str, float]:
        """Energy of all UAVs so far, by field of the summary, J: radio, computers, and all with that of motion.

        Stations have their own power.
        """
        radio, compute = float(self.radio_J[: self._scenario.uavs].sum()), float(self.compute_J.sum())
        total = float(self._flight.energy.sum()) + radio + compute
        return {"energy_radio_J": radio, "energy_compute_J": compute, "energy_total_J": total}
