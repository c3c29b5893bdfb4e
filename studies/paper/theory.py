"""Theory checked: what the paper proves, or what is known exactly, measured on the code that flies.

The density learner as an LMS filter (Prop. 3), and boundedness (Props. 1 and 2). `optimum.py` has the best possible
flight.
"""

from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.agent.controllers.mean_field.tables import tables
from meanflock.groundstation.launch.engine import Engine
from meanflock.kernels.mean_field import features, fpk, hjb
from meanflock.kernels.mean_field.layout import DENSITY, VALUE
from meanflock.swarm import state
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import Status
from meanflock.worldsim.flight import Flight

Floats = NDArray[np.float64]

# A slot fails once in 1e11 times and a message has a hundred of them, everybody is in range, nothing is rounded.
_CLEAR = {"target_snr_db": 40.0, "latency_threshold_slots": 100, "range_m": 1e9, "bits_per_float": 64}


# -- the density learner as an LMS filter (Prop. 3) ------------------------------------------------------------------


def fpk_gradients(scenario: Scenario, states: Floats, actions: Floats, curvature: Floats) -> Floats:
    """g = ∇_{ŵF} e_F at `states`, `(S, 138)`: the regressor of the LMS recursion, by the learner's own basis.

    Args:
        states: (S, 4). actions: â, (S, 2), m/s². curvature: ψ̂_vxvx + ψ̂_vyvy, (S,).
    """
    t = tables(scenario)
    pairs = features.pairs(t, features.powers(t, states))
    b = np.concatenate([states[:, state.VELOCITY], hjb.drift(t, states, actions)], axis=-1)
    operator = fpk.operator(t, pairs, b, fpk.divergence(t, curvature))
    return np.concatenate([operator, features.terms(t, pairs)[:, 1:]], axis=-1)


def correlation(gradients: Floats) -> Floats:
    """R = E[g gᵀ], Eq. R, `(M, M)`, of samples `(S, M)`."""
    return gradients.T @ gradients / len(gradients)


def step_bound(r: Floats) -> float:
    """2 / λ_max(R), Eq. step_cond: the mean of the weights converges for every μ_F below."""
    return 2.0 / float(np.linalg.eigvalsh(r)[-1])


def mean_square_deviation(r: Floats, start: Floats, mu: float, noise: float, steps: int) -> float:
    """E‖w̃(n)‖² of App. C, with Σ = I.

    In the eigenvectors of R the recursion E‖w̃‖²_Σ′ + μ²‖ε‖² tr(R_Σ) decouples:
    Σ_k (1−μλ_k)²ⁿ w̃_k(0)² + μ² σ² λ_k (1 − (1−μλ_k)²ⁿ) / (1 − (1−μλ_k)²). It leaves out the fourth moment of g, so
    it holds for small μ.

    Args:
        r: (M, M). start: w̃(0), (M,). mu: μ_F. noise: standard deviation of ε_F.
    """
    values, vectors = np.linalg.eigh(r)
    values = np.maximum(values, 0.0)
    decay = (1.0 - mu * values) ** 2
    left = decay**steps
    gain = np.divide(mu**2 * noise**2 * values, 1.0 - decay, out=np.zeros_like(values), where=decay < 1.0)
    return float((left * (vectors.T @ start) ** 2 + gain * (1.0 - left)).sum())


def simulate_lms(
    gradients: Floats, start: Floats, mu: float, noise: float, steps: int, repeats: int, seed: int
) -> Floats:
    """w̃(n) after `steps` steps of w̃ ← w̃ − μ g (gᵀw̃ + ε), Eq. Weight_err, `(repeats, M)`.

    Args:
        gradients: (S, M), drawn from at random. start: (M,). noise: standard deviation of ε.
    """
    draw = np.random.default_rng(seed)
    deviation = np.repeat(start[None], repeats, axis=0)
    for _ in range(steps):
        g = gradients[draw.integers(len(gradients), size=repeats)]
        error = state.dot(g, deviation) + noise * draw.standard_normal(repeats)
        deviation -= mu * error[:, None] * g
    return deviation


def learnable_directions(r: Floats, mu: float, steps: int) -> int:
    """How many eigendirections of R the mean moves by more than 1 − 1/e of the way in `steps` steps."""
    values = np.maximum(np.linalg.eigvalsh(r), 0.0)
    return int(np.count_nonzero((1.0 - mu * values) ** steps < np.exp(-1.0)))


# -- boundedness (Props. 1 and 2, Cor. 1) ----------------------------------------------------------------------------


@dataclass(frozen=True)
class LongFlight:
    """Norms along a long flight, each `(T,)`, the largest over the UAVs that are not lost.

    state: ‖s‖, m and m/s. value, density: ‖ŵ_H‖ and ‖ŵ_F‖. lost: UAVs whose learner or state left every bound.
    """

    state: Floats
    value: Floats
    density: Floats
    lost: int


def fly_long(scenario: Scenario, seconds: float) -> LongFlight:
    """Flies a scenario as `clear` makes it: under hjb everybody knows every state of the last tick."""
    engine = Engine(clear(scenario, seconds), "long")
    rows = [_norms(engine.world.flight, engine.models) for _ in engine.fly()]
    engine.world.finish()
    table = np.array(rows)
    return LongFlight(table[:, 0], table[:, 1], table[:, 2], int(table[-1, 3]))


def clear(scenario: Scenario, seconds: float) -> Scenario:
    """The same for `seconds`, arrivals or not, with a radio that loses nothing and rounds nothing."""
    radio = msgspec.structs.replace(scenario.radio, **_CLEAR)
    return msgspec.structs.replace(scenario, duration=seconds, stop="duration", radio=radio)


def _norms(flight: Flight, models: Floats) -> tuple[float, float, float, int]:
    alive = flight.status != Status.LOST
    if not alive.any():
        return (np.inf, np.inf, np.inf, len(alive))

    def largest(part: Floats) -> float:
        return float(np.sqrt(state.dot(part, part)).max())

    furthest, known = float(state.norm(flight.states[alive]).max()), models[alive]
    return furthest, largest(known[:, VALUE]), largest(known[:, DENSITY]), int((~alive).sum())


def growth(norms: Floats) -> float:
    """Largest norm of the last third of a flight over the largest of the first two; ≤ 1 means no new record."""
    cut = 2 * len(norms) // 3
    return float(norms[cut:].max() / norms[:cut].max())
