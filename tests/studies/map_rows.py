"""Runs of a small map with known answers."""

from typing import Any

from tests.studies import synthetic

SETTINGS = (
    "",
    "learner.position_scale=200, learner.velocity_scale=80, learner.kappa=0.04",
    "learner.position_scale=900, learner.velocity_scale=75, learner.kappa=0.03, federation.period=200",
    "learner.position_scale=300, learner.velocity_scale=60, learner.kappa=0, learner.multinomial=true",
    "learner.position_scale=300, learner.velocity_scale=120, learner.kappa=0.1",
)
ENERGY = (0.9, 0.5, 0.5, 0.95, 0.4)  # of mfgfl-hf; of the others 1, so that C13 holds under 0.84
ARRIVED = (25, 24, 24, 25, 3)


def map_rows(experiment: str = "map", seeds: tuple[int, ...] = (6001, 6002)) -> list[dict[str, Any]]:
    """Every setting under the methods that share models; in the last few arrive."""
    return [
        synthetic.row(
            experiment,
            method,
            seed,
            setting=setting,
            arrived=arrived,
            energy_mean_J=energy if method == "mfgfl-hf" else 1.0,
            t_avg_censored_s=110.0 if method == "mfgfl-hf" else 100.0,
            collisions_mission=0.0 if (method, seed) == ("mfgfl-hf", 6001) else 3.0,
        )
        for setting, energy, arrived in zip(SETTINGS, ENERGY, ARRIVED, strict=True)
        for method in ("mfgfl-h", "mfgfl-f", "mfgfl-hf")
        for seed in seeds
    ]
