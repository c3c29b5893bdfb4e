"""Other people's programs at comparable work, where they are installed. None is a dependency of meanflock."""

from collections.abc import Callable
from functools import partial

import numpy as np

from benchmarks.figure import Effort, Figure, Outcome, Say, in_turns, per_call_ms
from benchmarks.in_process import learner_step
from leader.aggregate import fedavg
from swarm import scenario, state
from swarm.model import MODEL_FLOATS
from worldsim.formation import initial_states

TITLE = "Peers"
ABOUT = (
    "Optional: whichever of these is importable is measured in turns with our own (`pip install pyrvo flwr`). ORCA "
    "(pyrvo, C++) plans a collision-free velocity from what every agent knows of every other; our learner plans from "
    "its own state and a density, and learns. Flower's aggregation averages the same twenty models as our leader."
)
UAVS, MODELS = 25, 20
_ORCA = (0.1, 15.0, 10, 5.0, 5.0, 0.35, 15.0)  # step s, neighbours m and number, horizons s, radius m, speed m/s


def run(effort: Effort, say: Say) -> Outcome:
    """Each peer by itself; one that is missing or fails is a note."""
    outcome = Outcome()
    for name, race in (("pyrvo", _orca), ("flwr", _flower)):
        say(name)
        try:
            outcome.figures += race(effort)
        except Exception as error:
            outcome.notes.append(f"{name}: not measured: {type(error).__name__}: {error}")
    return outcome


def _orca(effort: Effort) -> list[Figure]:
    import pyrvo

    flown = scenario.load(None, uavs=UAVS)
    plan = initial_states(flown)
    simulator = pyrvo.RVOSimulator(*_ORCA)
    for x, y in plan[:, state.POSITION]:
        simulator.set_agent_pref_velocity(simulator.add_agent((x, y)), (-x / 20.0, -y / 20.0))
    ms = _turns(effort, simulator.do_step, learner_step("mfgfl-hf", UAVS))
    peer = Figure("pyrvo: one ORCA step of 25 agents", "ms", ms["peer"])
    return [Figure("our learner step, 25 rows", "ms", ms["mine"], "neither", floor=peer), peer]


def _flower(effort: Effort) -> list[Figure]:
    from flwr.server.strategy.aggregate import aggregate

    draw = np.random.default_rng(1)
    models = {uav: draw.random(MODEL_FLOATS) for uav in range(MODELS)}
    ms = _turns(effort, partial(aggregate, [([model], 1) for model in models.values()]), partial(fedavg, models))
    peer = Figure("flwr: aggregate 20 models", "ms", ms["peer"])
    return [Figure("our fedavg of 20 models", "ms", ms["mine"], floor=peer), peer]


def _turns(effort: Effort, peer: Callable[[], object], mine: Callable[[], object]) -> dict[str, list[float]]:
    count = 100
    return in_turns(
        effort.of(15, 3), {"peer": lambda: per_call_ms(peer, count), "mine": lambda: per_call_ms(mine, count)}
    )
