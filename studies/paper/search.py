"""The map: a designed search over what the paper leaves open of its learner, and which claims hold where.

A Latin hypercube over the scales of the features, κ, c_H, the coefficients of the polynomial and the length of a round.
The rule by which settings are ranked is in docs/reproduction.md, and was written before its fresh seeds flew.
"""

import tomllib
from pathlib import Path

import numpy as np

SETTINGS = 300
SEEDS = range(6001, 6003)
FRESH = 7001  # the first seed of what was found, re-flown
_DESIGN_SEED = 20200403  # of the design, not of any flight
_SCALES = {"learner.position_scale": (100.0, 3000.0), "learner.velocity_scale": (10.0, 150.0)}  # log-uniform
_KAPPA, _STEEPNESS = (0.001, 0.2), (0.05, 5.0)  # log-uniform; and κ = 0 in one of six
_WITHOUT_CROSS_TERM = 1 / 6
EQUAL_ROUNDS = "federation.period=200"
MULTINOMIAL = "learner.multinomial=true"
# Settings that others had named before the search: today's default, slow steering twice, and the printed polynomial.
KNOWN = (
    (),
    ("learner.position_scale=200", "learner.velocity_scale=80", "learner.kappa=0.04"),
    ("learner.position_scale=1000", "learner.velocity_scale=75", "learner.kappa=0.035"),
    ("learner.position_scale=300", "learner.velocity_scale=60", "learner.kappa=0", MULTINOMIAL),
)


def design() -> list[tuple[str, ...]]:
    """The settings of the search: those known before, then the hypercube's."""
    from scipy.stats import qmc  # here: it takes a second to load, and workers draw no designs

    places = qmc.LatinHypercube(6, rng=_DESIGN_SEED).random(SETTINGS)
    return [*KNOWN, *(_settings(row) for row in places)]


def best() -> list[tuple[str, ...]]:
    """The ten settings of the highest score; `regimes.best` found them, and docs/reproduction.md has the rule."""
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
