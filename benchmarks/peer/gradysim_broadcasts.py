"""gradysim: 0.1 s of N nodes that move and broadcast 16 bytes to all, who keep them. `gradysim_broadcasts.py N`."""

import math
import sys

from gradysim.protocol.interface import IProtocol
from gradysim.protocol.messages.communication import CommunicationCommand, CommunicationCommandType
from gradysim.protocol.messages.mobility import GotoCoordsMobilityCommand
from gradysim.simulator.handler.communication import CommunicationHandler, CommunicationMedium
from gradysim.simulator.handler.mobility import MasslessMobilityConfiguration, MasslessMobilityHandler
from gradysim.simulator.handler.timer import TimerHandler
from gradysim.simulator.simulation import SimulationBuilder, SimulationConfiguration
from serve import serve

PERIOD_S = 0.1
STATE = "x" * 16  # four floats of 32 bits; messages of gradysim are text
ticks = 0


class Vehicle(IProtocol):
    """Broadcasts its state at 10 Hz and remembers the last it heard."""

    def initialize(self) -> None:
        self.heard = ""
        self.provider.send_mobility_command(GotoCoordsMobilityCommand(0.0, 0.0, 40.0))
        self.provider.schedule_timer("", PERIOD_S)

    def handle_timer(self, timer: str) -> None:
        global ticks
        ticks += self.provider.get_id() == 0
        self.provider.send_communication_command(CommunicationCommand(CommunicationCommandType.BROADCAST, STATE))
        self.provider.schedule_timer("", self.provider.current_time() + PERIOD_S)

    def handle_packet(self, message: str) -> None:
        self.heard = message

    def handle_telemetry(self, telemetry: object) -> None:
        pass

    def finish(self) -> None:
        pass


nodes = int(sys.argv[1])
side = math.ceil(math.sqrt(nodes))
builder = SimulationBuilder(SimulationConfiguration(duration=None, execution_logging=False))
builder.add_handler(TimerHandler())
builder.add_handler(CommunicationHandler(CommunicationMedium(transmission_range=100.0)))
builder.add_handler(MasslessMobilityHandler(MasslessMobilityConfiguration(update_rate=PERIOD_S)))
for number in range(nodes):
    builder.add_node(Vehicle, (1e6 + math.sqrt(2.0) * (number % side), 1e6 + math.sqrt(2.0) * (number // side), 40.0))
simulation = builder.build()


def tick() -> None:
    """Events until node 0 speaks again."""
    now = ticks
    while ticks == now:
        simulation.step_simulation()


serve(tick)
