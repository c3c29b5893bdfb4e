"""pyrvo: one step of ORCA (C++) for N agents √2 m apart that want to go the same way. `pyrvo_orca.py N`."""

import math
import sys

import pyrvo
from serve import serve

# step s, neighbours within m, at most, horizons s, radius m, speed m/s
SETTINGS = (0.1, 15.0, 10, 5.0, 5.0, 0.35, 15.0)

agents = int(sys.argv[1])
side = math.ceil(math.sqrt(agents))
simulator = pyrvo.RVOSimulator(*SETTINGS)
for number in range(agents):
    x, y = 150.0 + math.sqrt(2.0) * (number % side), 100.0 + math.sqrt(2.0) * (number // side)
    simulator.set_agent_pref_velocity(simulator.add_agent((x, y)), (-x / 20.0, -y / 20.0))
serve(simulator.do_step)
