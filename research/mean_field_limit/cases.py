"""The cases of the study with their seeds, and the rows of the results."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from research.mean_field_limit.flights import BEGINNING, DIRECTIONS, LEVELS, METHOD, TIMES_S, Floats, SwarmCase

FIRST_SEED = 95201  # no other study uses these seeds
REFERENCE = SwarmCase(100_000, BEGINNING)  # its one flight stands for the limit
BEGINNINGS = {10: 20, 30: 20, 100: 20, 300: 20, 1_000: 20, 3_000: 20, 10_000: 20}  # seeds of each N
WHOLE = {10: 40, 100: 40, 1_000: 20, 3_000: 4}  # seeds of each N
DEVIATIONS = ("plan", "cruise", "mfg")  # controllers of the last UAV, beside that of the swarm
DISTANCES = ("positions", "velocities")  # sliced Wasserstein-1, m and m/s
INTERACTIONS = ("phi_G", "phi_G_learned")  # root mean square of the difference over the nodes, 1/s²
Row = dict[str, Any]


def cases() -> dict[SwarmCase, range]:
    """Every case with its seeds: the reference first, then small swarms before large ones."""
    beginnings = {SwarmCase(uavs, BEGINNING): count for uavs, count in BEGINNINGS.items()}
    whole = {SwarmCase(uavs, name): count for uavs, count in WHOLE.items() for name in (METHOD, *DEVIATIONS)}
    counts = {REFERENCE: 1, **beginnings, **whole}
    return {case: range(FIRST_SEED, FIRST_SEED + count) for case, count in counts.items()}


def row_of(case: SwarmCase, seed: int, measured: Mapping[str, Any], reference: Mapping[str, Any]) -> Row:
    """Row of one flight: numbers of its summary and, of a beginning, its distances from the reference."""
    summary = {name: shortened(value) for name, value in measured.items() if not isinstance(value, bytes)}
    compared = distances(measured, reference) if case.flight == BEGINNING and case != REFERENCE else {}
    return {**case._asdict(), "seed": seed, **summary, **compared}


def distances(measured: Mapping[str, Any], reference: Mapping[str, Any]) -> dict[str, list[float]]:
    """Distances of a beginning from that of the reference, by name, at each time."""

    def of(name: str, kind: str, *shape: int) -> Floats:
        own, other = (np.frombuffer(row[name], kind).astype(np.float64) for row in (measured, reference))
        return (own - other).reshape(len(TIMES_S), *shape)

    found = {name: sliced_wasserstein(of(name, "<f4", DIRECTIONS, LEVELS)) for name in DISTANCES}
    found |= {name: root_mean_square(of(name, "<f8", -1)) for name in INTERACTIONS}
    return {name: shortened(values.tolist()) for name, values in found.items()}


def sliced_wasserstein(difference: Floats) -> Floats:
    """Sliced Wasserstein-1 distance of two sets of points, (...): the mean size of the difference of their quantiles,
    (..., K, L)."""
    distance: Floats = np.abs(difference).mean(axis=(-2, -1))
    return distance


def root_mean_square(difference: Floats) -> Floats:
    """Root mean square (...) over nodes of differences (..., Q)."""
    size: Floats = np.sqrt((difference**2).mean(axis=-1))
    return size


def shortened(value: Any) -> Any:
    """A number, or each of a list, with five significant digits; other values as they are."""
    if isinstance(value, list):
        return list(map(shortened, value))
    return float(f"{value:.5g}") if isinstance(value, float) else value
