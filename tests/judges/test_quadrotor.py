"""RotorPy flies the same craft under the same commands as the vehicle `quadrotor`, and gets to the same states.

Constants, gains and commanded accelerations are equal, and so is the rate of the controller, 500 Hz. All else is
RotorPy's own: controller, mixer, rotors, rigid body, and a Runge–Kutta integrator in place of our steps. Its
aerodynamics are off, and so are our drag and wind.
"""

import json
from pathlib import Path

import numpy as np
import pytest

from meanflock.kernels.quadrotor import ATTITUDE, ROTORS
from meanflock.swarm.scenario import Scenario
from meanflock.worldsim.vehicles.quadrotor import Quadrotor
from tests.commands import printed

SCRIPT = Path(__file__).with_name("rotorpy_flies.py")
JUDGE = "rotorpy"
DT_S = 0.02
COMMANDS = {  # m/s², for half a second each
    "forward and back": [(3.0, 0.0, 0.0), (-3.0, 0.0, 0.0)],
    "sideways and up": [(0.0, 2.0, 3.0), (0.0, 0.0, -4.0)],
    "a turn": [(4.0, 0.0, 0.0), (0.0, 4.0, 0.0), (-4.0, 0.0, 1.0)],
    "hard": [(8.0, -6.0, -3.0), (-8.0, 6.0, 5.0)],
}
CALM = {"space.dimensions": 3, "wind.sigma": 0.0, "wind.drag": 0.0, "dt": DT_S, "uavs": 1}
TOLERANCE = 0.005  # of the range of a quantity


def ours(commands: list[tuple[float, ...]]) -> dict[str, np.ndarray]:
    """Our states after every tick, under RotorPy's names."""
    vehicle = Quadrotor(Quadrotor.Options(), Scenario(**CALM))
    states, hidden, seen, bodies = np.zeros((1, 6)), vehicle.init(1), [], []
    for command in commands:
        states, hidden = vehicle.step(states, hidden, np.array([command]), np.zeros((1, 3)), np.zeros((1, 3)))
        seen.append(states[0])
        bodies.append(hidden["body"][0])
    flown, body = np.array(seen), np.array(bodies)
    attitude = body[:, ATTITUDE][:, [1, 2, 3, 0]]
    return {"x": flown[:, :3], "v": flown[:, 3:], "rotor_speeds": body[:, ROTORS], "q": attitude}


@pytest.fixture(scope="module")
def theirs(python: Path) -> dict[str, dict[str, np.ndarray]]:
    """RotorPy's states after every tick, by flight."""
    known = Quadrotor.Options()
    constants = {"mass": known.mass_kg, "k_eta": known.k_eta, "k_m": known.k_m, "tau_m": known.tau_s}
    constants |= dict(zip(("Ixx", "Iyy", "Izz"), known.inertia_kg_m2, strict=True))
    constants |= {"rotor_speed_max": known.speed_max_rad_s, "kp_att": known.k_p, "kd_att": known.k_d}
    steps = round(DT_S * known.rate_hz)
    commands = [ticks(each) for each in COMMANDS.values()]
    asked = {"step_s": DT_S / steps, "steps": steps, "commands": commands, "constants": constants}
    flights = json.loads(printed(python, SCRIPT, json.dumps(asked)).splitlines()[-1])
    return {
        flight: {name: np.array([state[name] for state in states]) for name in states[0]}
        for flight, states in zip(COMMANDS, flights, strict=True)
    }


def ticks(commands: list[tuple[float, ...]]) -> list[tuple[float, ...]]:
    return [command for command in commands for _ in range(25)]


@pytest.mark.parametrize("flight", COMMANDS)
def test_rotorpy_and_the_quadrotor_agree(flight: str, theirs: dict[str, dict[str, np.ndarray]]) -> None:
    for name, flown in ours(ticks(COMMANDS[flight])).items():
        judged = theirs[flight][name]
        if name == "q":
            judged = judged * np.sign((judged * flown).sum(axis=1, keepdims=True))  # q and −q are one attitude
        error = np.abs(flown - judged).max()
        assert error < TOLERANCE * np.ptp(judged), name
