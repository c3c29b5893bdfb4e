"""A script for an environment with RotorPy: flies its Hummingbird under accelerations, and prints the states.

Argument: JSON with `step_s`, the step of its controller, `steps` of a tick, `commands`, lists of accelerations, m/s²,
of a tick each, and `constants` of the craft under RotorPy's names. Prints positions, velocities, rotor speeds and
attitudes [x, y, z, w] after every tick as JSON, a list for each list of commands.
"""

import json
import sys

import numpy as np
from rotorpy.vehicles.hummingbird_params import quad_params
from rotorpy.vehicles.multirotor import Multirotor

asked = json.loads(sys.argv[1])
known = {name: quad_params[name] for name in asked["constants"]}
if known != asked["constants"]:
    sys.exit(f"RotorPy has other constants: {known}")
hover = np.full(4, np.sqrt(quad_params["mass"] * 9.81 / 4 / quad_params["k_eta"]))
begin = {"x": np.zeros(3), "v": np.zeros(3), "q": np.array([0, 0, 0, 1.0]), "w": np.zeros(3), "wind": np.zeros(3)}
GRAVITY = (0.0, 0.0, 9.81)  # m/s², which its commands include
flights = []
for commands in asked["commands"]:
    craft = Multirotor(quad_params, control_abstraction="cmd_acc", aero=False)
    state, states = begin | {"rotor_speeds": hover}, []
    for acceleration in commands:
        for _ in range(asked["steps"]):
            state = craft.step(state, {"cmd_acc": np.add(acceleration, GRAVITY)}, asked["step_s"])
        states.append({name: state[name].tolist() for name in ("x", "v", "rotor_speeds", "q")})
    flights.append(states)
print(json.dumps(flights))
