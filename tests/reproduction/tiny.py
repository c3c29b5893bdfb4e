"""A plan of tiny runs, and what flies it."""

from pathlib import Path
from typing import Any

from meanflock.swarm.scenario import load
from reproduction.experiments import run_grid
from reproduction.grid import Point, Wanted
from reproduction.tables import Results


def tiny(method: str, *settings: str, uavs: int = 3, duration: float = 3.0) -> Any:
    return load(None, settings, method=method, uavs=uavs, duration=duration, stop="duration")


def plan() -> list[Wanted]:
    points = [
        Point("s0", tiny("mfgfl-hf", "federation.period=10")),
        Point("s0", tiny("hjb")),
        Point("uavs", tiny("mfgfl-hf", "federation.period=10")),
        Point("offline", tiny("offline", "start.spacing=6"), "start.spacing=6"),
        Point("trained", tiny("mfgfl-hf", "wind.sigma=1.5"), training=tiny("mfgfl-hf")),
        Point("sensitivity", tiny("mfg", "learner.kappa=0.1"), "learner.kappa=0.1"),
    ]
    return [Wanted(point, seed) for point in points for seed in (1, 2)]


def fly(out: Path, **options: Any) -> Results:
    return run_grid(out, 1, jobs=options.pop("jobs", 1), quiet=True, plan=options.pop("plan", plan()), **options)


def same(left: Results, right: Results) -> bool:
    return all(
        getattr(left, name).equals(getattr(right, name)) for name in ("runs", "series", "trajectories", "weights")
    )
