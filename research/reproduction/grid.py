"""The experiments of the paper as data: scenarios, names and seeds."""

import enum
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from meanflock.swarm.scenario import Scenario, load

# -- methods -----------------------------------------------------------------------------------------------------------


class Method(enum.StrEnum):
    """Methods of the paper, by learning and sharing."""

    HJB = "hjb"  # value network only; every state, every tick, to every UAV in range
    MFG = "mfg"  # value and density networks; initial states only
    MFGFL_H = "mfgfl-h"  # ... and value models averaged by the leader
    MFGFL_F = "mfgfl-f"  # ... and density models averaged
    MFGFL_HF = "mfgfl-hf"  # ... and both averaged
    OFFLINE = "offline"  # nothing: an open-loop plan computed before take-off, blind to others and wind

    @property
    def learns_value(self) -> bool:
        """Runs the HJB learner."""
        return self is not Method.OFFLINE

    @property
    def learns_density(self) -> bool:
        """Runs the FPK learner."""
        return self not in (Method.HJB, Method.OFFLINE)


# -- designed search ---------------------------------------------------------------------------------------------------


MAP_SETTINGS = 300
MAP_SEEDS = range(6001, 6003)
FIRST_SEED = 101001  # of the paper's scenario
FRESH_SEED = 107001  # of other scenarios, and of the settings that fly again
_DESIGN_SEED = 20200403  # of the design, not of any flight
_SCALES = {"learner.position_scale": (100.0, 3000.0), "learner.velocity_scale": (10.0, 150.0)}  # log-uniform
_KAPPA, _STEEPNESS = (0.001, 0.2), (0.05, 5.0)  # log-uniform; and κ = 0 in one of six
_WITHOUT_CROSS_TERM = 1 / 6
EQUAL_ROUNDS = "federation.period=200"
MULTINOMIAL = "learner.multinomial=true"
EXCHANGED = "learner.exchanged_rounds=true"
# Settings that others had named before the search: today's default, slow steering twice, and the printed polynomial.
KNOWN = (
    (),
    ("learner.position_scale=200", "learner.velocity_scale=80", "learner.kappa=0.04"),
    ("learner.position_scale=1000", "learner.velocity_scale=75", "learner.kappa=0.035"),
    ("learner.position_scale=300", "learner.velocity_scale=60", "learner.kappa=0", MULTINOMIAL),
)


def map_design() -> list[tuple[str, ...]]:
    """The settings of the search: the four named ones, then those of the hypercube."""
    from scipy.stats import qmc  # here: it takes a second to load, and workers draw no designs

    places = qmc.LatinHypercube(6, rng=_DESIGN_SEED).random(MAP_SETTINGS)
    return [*KNOWN, *(_settings(row) for row in places)]


def best_settings() -> list[tuple[str, ...]]:
    """The ten settings with the highest score, chosen by `regimes.best` (the rule is in docs/reproduction.md)."""
    text = Path(__file__).with_name("best.toml").read_text(encoding="utf-8")
    return [tuple(settings) for settings in tomllib.loads(text)["settings"]]


def _settings(place: np.ndarray) -> tuple[str, ...]:
    values = dict(zip(_SCALES, (_log(u, *ends) for u, ends in zip(place, _SCALES.values(), strict=False)), strict=True))
    share = (place[2] - _WITHOUT_CROSS_TERM) / (1 - _WITHOUT_CROSS_TERM)
    values["learner.kappa"] = _log(share, *_KAPPA) if share > 0 else 0.0
    values["learner.c_h"] = _log(place[3], *_STEEPNESS)
    settings = [f"{name}={value:.3g}" for name, value in values.items()]
    return (*settings, *([MULTINOMIAL] if place[4] < 0.5 else []), *([EQUAL_ROUNDS] if place[5] < 0.5 else []))


def _log(share: float, low: float, high: float) -> float:
    return float(low * (high / low) ** share)


# -- experiments -------------------------------------------------------------------------------------------------------


LEARNING = (Method.HJB, Method.MFG, Method.MFGFL_H, Method.MFGFL_F, Method.MFGFL_HF)
FEDERATED = (Method.MFGFL_H, Method.MFGFL_F, Method.MFGFL_HF)
COMPARED = (Method.HJB, *FEDERATED)

UAVS = (16, 25, 36, 49, 64)
PERIODS = (50, 100, 200, 300, 400, 500)
SIGMAS = (0.1, 0.2, 0.3, 0.4, 0.5)
TRAINED_SIGMA = 1.5
TRAINING_SEEDS = 10_000  # the flight that trains has another seed than the flight it trains for
WHOLE = "federation.fragment=0"  # as in the paper, models are lost rather than cut where the radio has no room for them
REPELLED = "cost.separation=5"  # what keeps UAVs half a metre apart; see docs/keys.md
# Structural readings of the paper, see docs/reproduction.md.
PAPER_EXCHANGED = "learner.position_scale=314", "learner.velocity_scale=37", "learner.kappa=0.012", EXCHANGED
COMMON = (0.5, 0.9, 1.0)  # wind.common
HELD_BACK = "learner.act_after_s=10"
DRIFTING = "learner.act_after_s=300"  # the whole flight
WITHOUT_DENSITY = "cost.c2=0"
LOSSLESS = "radio.model=ideal"
FEWER_UPLOADS = "federation.fraction=0.7"  # of 0.8: an eighth less, as many as mfgfl-hf loses
SEPARATED = (
    "start.spacing=6"  # at 5 m the offline programs pass each other at 0.103 m without wind, at √2 m they collide
)

# One at a time around S0: what the paper leaves open (model.md), within and beyond reason.
FREE: dict[str, tuple[Any, ...]] = {
    "learner.kappa": (0.0, 0.003, 0.03, 0.1),
    "learner.position_scale": (150.0, 300.0, 400.0),
    "learner.velocity_scale": (10.0, 15.0, 30.0, 40.0),
    "cost.epsilon": (0.1, 10.0),
    "cost.beta": (0.5, 2.0),
    "destination.radius": (2.0, 10.0),
    "radio.target_snr_db": (70.0, 78.0),
    "radio.coherence_time_s": (2.5e-5, 1e-4),
    "radio.latency_threshold_slots": (4, 16),
    "radio.fading": ("power",),
}
RANDOM_POINTS = 24
_RANDOM_SEED = 20200310  # of the design, not of any flight
_RANGES = {  # log-uniform
    "learner.kappa": (0.003, 0.1),
    "learner.position_scale": (150.0, 400.0),
    "learner.velocity_scale": (10.0, 40.0),
    "cost.epsilon": (0.1, 10.0),
    "cost.beta": (0.5, 2.0),
    "destination.radius": (2.0, 10.0),
}

# name → (seeds relative to those asked for, whether a series is kept)
EXPERIMENTS: dict[str, tuple[float, bool]] = {
    "s0": (10 / 3, True),
    "uavs": (1.0, True),
    "period": (1.0, True),
    "period-tied": (1.0, False),
    "wind": (1.0, True),
    "offline": (1.0, True),
    "trained": (1.0, True),
    "sensitivity": (1 / 3, False),
    "random": (1 / 6, False),
    "separation": (1 / 3, False),
    "map": (0.0, False),  # its two seeds are its own
    "found": (1.0, False),
    "exchanged": (1.0, False),
    "exchanged-map": (0.0, False),  # its seeds are those of the map
    "common": (1.0, False),
    "held-back": (1.0, True),
    "drift": (1.0, True),
    "density": (1.0, False),
    "losses": (1.0, False),
}


FEWEST = {"separation": 10}  # flights of a point at least: three flights would leave O4 undecided
TRACED = frozenset({"s0", "offline", "trained", "held-back"})  # the first seed of each point


@dataclass(frozen=True)
class Point:
    """One setting of one experiment. `flown` has no seed yet; `training` flies before it and gives it weights."""

    experiment: str
    flown: Scenario
    setting: str = ""
    training: Scenario | None = None


@dataclass(frozen=True)
class Wanted:
    """One run: a point and a seed."""

    point: Point
    seed: int
    scenario: Scenario = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "scenario", _seeded(self.point.flown, self.seed))

    @property
    def training(self) -> Scenario | None:
        """The flight that gives this one its initial weights."""
        training = self.point.training
        return None if training is None else _seeded(training, self.seed + TRAINING_SEEDS)

    @cached_property
    def key(self) -> str:
        """Identity of the run: equal keys have equal bits."""
        training = self.training
        return self.scenario.sha256() + ("" if training is None else "<" + training.sha256())

    @property
    def traced(self) -> bool:
        """Returns whether trajectory and weights are recorded: the first seed of the flights in figures 2 and 8, and of
        those whose direction C7 is about."""
        return self.seed in (FIRST_SEED, FRESH_SEED) and self.point.experiment in TRACED


def _seeded(flown: Scenario, seed: int) -> Scenario:
    return msgspec.structs.replace(flown, seed=seed)


def points(scenario: Path | None = None) -> Iterator[Point]:
    """Every point of the grid about a scenario, by default the paper's; all fly for 300 s, so that φ(175 s)
    exists and curves have one length. What surrounds the paper's alone, open parameters and map, is left out of others.
    """

    def fly(method: Method, *settings: str, uavs: int = 25) -> Scenario:
        if any(setting.startswith("radio.") for setting in settings):
            settings = *settings, WHOLE
        return load(scenario, settings, method=str(method), uavs=uavs, duration=300.0, stop="duration")

    for method in (*LEARNING, Method.OFFLINE):
        yield Point("s0", fly(method))
    for method, uavs in product(LEARNING, UAVS):
        yield Point("uavs", fly(method, uavs=uavs))
    for method, period in product(FEDERATED, PERIODS):
        yield Point("period", fly(method, f"federation.period={period}"))
    for period in PERIODS:  # C38: a shorter period leaves less time for an upload; D_M = 8 slots at HF's own 200
        tied = f"radio.latency_threshold_slots={max(1, round(8 * period / 200))}"
        yield Point("period-tied", fly(Method.MFGFL_HF, f"federation.period={period}", tied), tied)
    for method, sigma in product(COMPARED, SIGMAS):
        yield Point("wind", fly(method, f"wind.sigma={sigma}"))
    for sigma, spacing in product((0.0, 0.1), ("", SEPARATED)):
        settings = [f"wind.sigma={sigma}", *filter(None, [spacing])]
        yield Point("offline", fly(Method.OFFLINE, *settings), spacing)
    windy = fly(Method.MFGFL_HF, f"wind.sigma={TRAINED_SIGMA}")
    yield Point("trained", windy, training=fly(Method.MFGFL_HF))
    yield Point("trained", windy)  # the same wind, untrained
    yield Point("trained", fly(Method.OFFLINE, f"wind.sigma={TRAINED_SIGMA}"))
    for method in COMPARED:
        yield Point("separation", fly(method, REPELLED), REPELLED)
    if scenario is not None:
        return
    for method, (name, values) in product(COMPARED, FREE.items()):
        for value in values:
            setting = f"{name}={value}"
            yield Point("sensitivity", fly(method, setting), setting)
    for settings in random_design():
        for method in COMPARED:
            yield Point("random", fly(method, *settings), ", ".join(settings))
    for place in map_design():
        for method in FEDERATED:
            yield Point("map", fly(method, *place), ", ".join(place))
    for place in best_settings():
        for method in COMPARED:
            yield Point("found", fly(method, *place), ", ".join(place))
    for experiment, method, place in structural():
        yield Point(experiment, fly(method, *place), ", ".join(place))


def structural() -> Iterator[tuple[str, Method, tuple[str, ...]]]:
    """Experiment, method and settings of every point of the structural readings, and of what explains them."""
    for place, method in product(((EXCHANGED,), PAPER_EXCHANGED), COMPARED):
        yield "exchanged", method, place
    for place in map_design():
        if EQUAL_ROUNDS not in place:
            yield from (("exchanged-map", method, (*place, EXCHANGED)) for method in FEDERATED)
    for base, share, method in product(((), PAPER_EXCHANGED), COMMON, COMPARED):
        yield "common", method, (*base, f"wind.common={share}")
    for base, method in product(((), PAPER_EXCHANGED), COMPARED):
        yield "held-back", method, (*base, HELD_BACK)
    for share in (0.0, *COMMON):
        yield "drift", Method.MFG, (DRIFTING, f"wind.common={share}")
    for method in COMPARED:
        yield "density", method, (WITHOUT_DENSITY,)
    for method in (Method.MFGFL_H, Method.MFGFL_HF):
        yield "losses", method, (EQUAL_ROUNDS, LOSSLESS)
    yield "losses", Method.MFGFL_HF, (EQUAL_ROUNDS, LOSSLESS, FEWER_UPLOADS)


def random_design() -> list[list[str]]:
    """All free parameters of the learners at once: a Latin hypercube in their logarithms."""
    low, high = np.log(np.array(list(_RANGES.values()))).T
    from scipy.stats import qmc  # here: it takes a second to load, and workers draw no designs

    places = qmc.LatinHypercube(len(_RANGES), rng=_RANDOM_SEED).random(RANDOM_POINTS)
    design = np.exp(low + (high - low) * places)
    return [[f"{name}={value:.4g}" for name, value in zip(_RANGES, row, strict=True)] for row in design]


def seeds_of(experiment: str, seeds: int, fresh: bool = False) -> range:
    """Seeds from `FIRST_SEED` or, if `fresh`, `FRESH_SEED` on, `seeds` times the experiment's share of them."""
    if experiment in ("map", "exchanged-map"):
        return MAP_SEEDS
    first = FRESH_SEED if fresh or experiment == "found" else FIRST_SEED
    return range(first, first + max(FEWEST.get(experiment, 1), round(seeds * EXPERIMENTS[experiment][0])))


def wanted(seeds: int, scenario: Path | None = None) -> list[Wanted]:
    """Rows of the table of runs. Several rows can share a run: see `Wanted.key`."""
    return [
        Wanted(point, seed)
        for point in points(scenario)
        for seed in seeds_of(point.experiment, seeds, scenario is not None)[
            : 1 if point.flown.wind.sigma == 0 else None
        ]
    ]
