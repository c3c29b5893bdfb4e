"""crazyflow: a control step of N drones on a CPU, 10 ms of flight in 5 steps of physics. `crazyflow_control.py N`."""

import sys
from contextlib import redirect_stdout

import jax
import numpy as np
from serve import serve

with redirect_stdout(sys.stderr):  # MuJoCo says there what it could have loaded
    from crazyflow.control import Control
    from crazyflow.sim import Sim

jax.config.update("jax_cpu_enable_async_dispatch", False)  # faster for so few: no hand-over to a thread
drones = int(sys.argv[1])
simulator = Sim(n_drones=drones, control=Control.state, freq=500, state_freq=100, device="cpu")
simulator.reset()
start = np.asarray(simulator.data.states.pos)
wanted = np.zeros((1, drones, 16), dtype=np.float32)  # position, velocity, acceleration, attitude, rates
wanted[..., :3] = start + np.float32((0.0, 0.0, 1.0))
wanted[..., 12] = 1.0  # the real part of the quaternion that is upright


def control_step() -> None:
    simulator.state_control(wanted)
    simulator.step(simulator.freq // simulator.control_freq)
    jax.block_until_ready(simulator.data)


serve(control_step)
assert np.asarray(simulator.data.states.pos - start)[..., 2].min() > 0.0  # they did take off
