"""Measurements for the theory, by seed: long flights, moments of the LMS filter, and gaps to the optimum."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.launch.engine import Engine
from meanflock.launch.station import StoredTelemetry
from meanflock.studies import runner
from meanflock.studies.store import DATA
from meanflock.swarm import state
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import Status
from research.reproduction import theory
from research.reproduction.flight import version
from research.reproduction.grid import FIRST_SEED, LEARNING, Method

Floats = NDArray[np.float64]

MEASURED = "theory.json"
SEEDS = range(FIRST_SEED, FIRST_SEED + 8)
LONG_S = 1750.0  # ten trips
TRIP_S = 175.0
NOISE = 0.02  # ε_F: as large as the paper lets the residual be
RELATIVE_STEP = 0.003  # μ over its bound: small
_EXCITED = 1.0 / 30.0  # directions with at least this share of λ_max are followed
REPEATS = 800


def long_flight(scenario: Scenario, seconds: float) -> dict[str, float]:
    """`state`, `value`, `density`: growth of the norms (see `theory.growth`); `lost`: UAVs that left every bound."""
    flown = theory.fly_long(scenario, seconds)
    result = {"state_growth": theory.growth(flown.state), "value_growth": theory.growth(flown.value)}
    if Method(scenario.method).learns_density:
        result["density_growth"] = theory.growth(flown.density)
    return {**result, "lost": float(flown.lost)}


def filter_moments(
    scenario: Scenario, states: Floats, relative_step: float = RELATIVE_STEP, repeats: int = REPEATS
) -> dict[str, float]:
    """Prop. 3 on the gradients at `states`, `(S, 4)`, without command.

    step_over_bound: μ_F of the scenario over 2/λ_max. learnable: directions of 138 the mean moves in one trip.
    followed: directions that the flight excites. bias: ‖E w̃‖ at the end over its start. msd_ratio: simulated over
    closed-form E‖w̃‖². msd_fall: simulated MSD at half the step over that at the step. The last three with a small step,
    in the directions followed, for as long as the slowest of them takes.
    """
    gradients = theory.fpk_gradients(scenario, states, np.zeros(state.velocity(states).shape), np.zeros(len(states)))
    r = theory.correlation(gradients)
    bound = theory.step_bound(r)
    values, vectors = np.linalg.eigh(r)
    excited = values > _EXCITED * values[-1]
    followed = gradients @ vectors[:, excited]
    reduced = theory.correlation(followed)
    start = np.full(followed.shape[1], NOISE)
    mu = relative_step * bound

    def simulate(step: float) -> tuple[Floats, int]:
        steps = int(6.0 / (step * values[excited][0]))
        return theory.simulate_lms(followed, start, step, NOISE, steps, repeats, scenario.seed), steps

    (wide, steps), (narrow, _) = simulate(mu), simulate(mu / 2)

    def msd(deviation: Floats) -> float:
        return float(state.dot(deviation, deviation).mean())

    return {
        "step_over_bound": scenario.learner.mu_f / bound,
        "learnable": float(theory.learnable_directions(r, scenario.learner.mu_f, round(TRIP_S / scenario.dt))),
        "followed": float(np.count_nonzero(excited)),
        "bias": float(np.linalg.norm(wide.mean(axis=0)) / np.linalg.norm(start)),
        "msd_ratio": msd(wide) / theory.mean_square_deviation(reduced, start, mu, NOISE, steps),
        "msd_fall": msd(narrow) / msd(wide),
    }


def trip_states(scenario: Scenario) -> Floats:
    """States of all UAVs and ticks of one trip under Algorithm 2, `(S, 4)`."""
    engine = Engine(theory.clear(msgspec.structs.replace(scenario, method=Method.MFG), TRIP_S), "trip")
    flight = engine.world.flight
    states = [flight.states[flight.status != Status.LOST] for _ in engine.fly()]
    engine.finish()
    return np.concatenate(states)


def gap(scenario: Scenario) -> tuple[float, float]:
    """Median over UAVs of realised over optimal cost, the optimum without noise; and the same without the distance left
    at arrival; see `theory.gaps`."""
    stored = StoredTelemetry()
    engine = Engine(scenario, "gap", sinks=[stored])
    engine.complete()
    states = np.concatenate([block.states for block in stored.blocks])
    commands = np.concatenate([block.accelerations for block in stored.blocks]).astype(np.float64)[1:]
    arrival = engine.world.flight.arrival_tick
    whole, moving = (theory.gaps(scenario, states, commands, arrival, moving=without) for without in (False, True))
    return float(np.median(whole)), float(np.median(moving))


def measure_seed(scenario: Scenario, seconds: float) -> dict[str, float]:
    """All measurements for one seed, by name."""
    found: dict[str, float] = {}

    def keep(prefix: str, numbers: dict[str, float]) -> None:
        found.update({f"{prefix}_{name}": value for name, value in numbers.items()})

    for method in (Method.HJB, Method.MFG):
        keep(str(method), long_flight(msgspec.structs.replace(scenario, method=method), seconds))
    plain = msgspec.structs.replace(scenario, method=Method.MFG)
    keep("fpk", filter_moments(plain, trip_states(plain)))
    for method in LEARNING:
        whole, moving = gap(msgspec.structs.replace(scenario, method=method))
        keep("gap", {str(method): whole, f"{method}_moving": moving})
    return found


def measure(
    seeds: Sequence[int] = SEEDS,
    seconds: float = LONG_S,
    scenario: Scenario | None = None,
    jobs: int = -1,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> dict[str, list[float]]:
    """All measurements for the paper's scenario, or another: name → a value for each seed.

    Ask for six seeds or more: with fewer, no exact interval of a share lies on one side of one half.

    Args:
        seconds: length of the long flights. jobs: processes, -1 for one a core. progress: is told seeds done, of all.
    """
    base = scenario or Scenario()
    flights = [msgspec.structs.replace(base, seed=seed) for seed in seeds]
    rows: dict[int, dict[str, float]] = {}

    def keep(flown: Scenario, row: dict[str, float]) -> None:
        rows[flown.seed] = row
        progress(len(rows), len(flights))

    progress(0, len(flights))
    runner.run(partial(measure_seed, seconds=seconds), flights, jobs, keep)
    return {name: [rows[seed][name] for seed in seeds] for name in (rows[seeds[0]] if rows else {})}


def measured(
    out: Path,
    seeds: Sequence[int] = SEEDS,
    seconds: float = LONG_S,
    jobs: int = -1,
    progress: Callable[[int, int], None] = lambda done, total: None,
    scenario: Scenario | None = None,
) -> dict[str, list[float]]:
    """`measure` of the paper's scenario, or of the one the folder is for, unless `out`/data holds it for this code,
    these seeds and seconds."""
    known = load_measured(out, list(seeds), seconds)
    if not known:
        known = measure(seeds, seconds, scenario, jobs=jobs, progress=progress)
        keep_measured(out, known, seeds, seconds)
    return known


class _Measured(msgspec.Struct):
    version: str  # of the code measured, as in `runs`
    seeds: list[int]
    seconds: float
    numbers: dict[str, list[float]]


def load_measured(
    out: Path, seeds: Sequence[int] | None = None, seconds: float | None = None
) -> dict[str, list[float]]:
    """The numbers that `keep_measured` wrote; empty without a file, or if code, seeds or seconds differ."""
    path = out / DATA / MEASURED
    if not path.is_file():
        return {}
    try:
        stored = msgspec.json.decode(path.read_bytes(), type=_Measured)
    except msgspec.MsgspecError as error:
        raise BadInput(f"{path}: {error}; delete it and measure again") from error
    fits = stored.version == version() and seeds in (None, stored.seeds) and seconds in (None, stored.seconds)
    return stored.numbers if fits else {}


def keep_measured(out: Path, numbers: Mapping[str, Sequence[float]], seeds: Sequence[int], seconds: float) -> None:
    """Write the numbers of `measure` for `load_measured`."""
    stored = _Measured(version(), list(seeds), seconds, {name: list(values) for name, values in numbers.items()})
    (out / DATA).mkdir(parents=True, exist_ok=True)
    (out / DATA / MEASURED).write_bytes(msgspec.json.format(msgspec.json.encode(stored)) + b"\n")
