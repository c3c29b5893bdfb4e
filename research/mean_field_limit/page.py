"""The tables of docs/mean-field-limit.md."""

from collections.abc import Sequence

import numpy as np

from meanflock.results import statistics
from meanflock.results.statistics import Estimate
from meanflock.studies import published
from meanflock.studies.markdown import table, with_parts
from research.mean_field_limit.cases import DEVIATIONS, DISTANCES, FIRST_SEED, INTERACTIONS, REFERENCE, Row
from research.mean_field_limit.fit import FIT
from research.mean_field_limit.flights import BEGINNING, METHOD, TIMES_S

PAGE = published.DOCS / "mean-field-limit.md"
RESULTS = published.DOCS / "results" / "mean_field_limit.json"
EXPECTED = -0.5  # exponent of N in each of the distances, stated before the flights
LARGE = (0, 100, 1_000)  # UAVs from which on each fit goes
NAMES = {
    "positions": "sliced W₁ of positions, m",
    "velocities": "sliced W₁ of velocities, m/s",
    "phi_G": "φ_G of the true states, 1/s²",
    "phi_G_learned": "φ_G of the learned density, 1/s²",
}
LAST = {"last_cost_m": "cost, m", "last_time_s": "T, s", "last_energy_J": "E, J"}  # of the UAV that may deviate


def page(text: str, code: str, rows: Sequence[Row]) -> str:
    """The page `text` with the tables of these flights."""
    count = sum(row["flight"] != FIT for row in rows)
    parts = {
        "flights": [f"{count:,} flights with seeds from {FIRST_SEED} on. {published.flown_by(code)}", "", *flown(rows)],
        "exponents": exponents(rows),
        "distances": distances(rows),
        "beginnings": beginnings(rows),
        "fits": fits(rows),
        "whole": whole(rows),
        "deviations": deviations(rows),
    }
    return with_parts(text, parts)


def sizes(rows: Sequence[Row], flight: str) -> list[int]:
    """Numbers of UAVs that flew such a flight, ascending."""
    return sorted({row["uavs"] for row in rows if row["flight"] == flight})


def of(rows: Sequence[Row], uavs: int, flight: str) -> list[Row]:
    """The flights of a case, by ascending seed."""
    return [row for row in rows if (row["uavs"], row["flight"]) == (uavs, flight)]


def flown(rows: Sequence[Row]) -> list[str]:
    """A row for each N: its seeds of the first 20 s, and of whole flights with each controller of the last UAV."""
    kinds = (BEGINNING, METHOD, *DEVIATIONS)
    every = sorted({row["uavs"] for row in rows})
    head = ("N", "first 20 s", *(f"whole, last UAV `{name}`" for name in kinds[1:]))
    return table(head, [(f"{uavs:,}", *(str(len(of(rows, uavs, kind)) or "–") for kind in kinds)) for uavs in every])


def exponent(rows: Sequence[Row], name: str, time: int, least: int = 0) -> Estimate:
    """Exponent of N in a distance from the reference, from N = `least` on: mean slope of its logarithm over seeds."""
    swarms = [uavs for uavs in sizes(rows, BEGINNING) if least <= uavs < REFERENCE.uavs]
    found = {(row["uavs"], row["seed"]): row[name][time] for row in rows if row["flight"] == BEGINNING and name in row}
    seeds = sorted({seed for _, seed in found if all((uavs, seed) in found for uavs in swarms)})
    logarithms = np.log([[found[uavs, seed] for uavs in swarms] for seed in seeds])
    return statistics.mean(statistics.slopes(np.log(swarms), logarithms))


def verdict(found: Estimate) -> str:
    """A fitted exponent beside the expected one, in words."""
    if found.low <= EXPECTED <= found.high:
        return "undecided" if found.high >= 0.0 else "as expected"
    return "slower" if found.low > EXPECTED else "faster"


def exponents(rows: Sequence[Row]) -> list[str]:
    """A row for each distance and time: fitted exponents and the verdicts."""
    lines = []
    for name in (*DISTANCES, *INTERACTIONS):
        for time, second in enumerate(TIMES_S):
            fits = [exponent(rows, name, time, least) for least in LARGE]
            lines.append(
                (NAMES[name], f"{second:g}", *(cell for fit in fits for cell in (_interval(fit, ".2f"), verdict(fit))))
            )
    heads = ("exponent, all N", *(f"N ≥ {least:,}" for least in LARGE[1:]))
    return table(("distance", "t, s", *(cell for head in heads for cell in (head, "verdict"))), lines)


def distances(rows: Sequence[Row]) -> list[str]:
    """A row for each N: its distances from the reference after 20 s."""
    names = (*DISTANCES, *INTERACTIONS)
    return table(
        ("N", *(NAMES[name] for name in names)),
        [
            (
                f"{uavs:,}",
                *(statistics.mean([row[name][-1] for row in of(rows, uavs, BEGINNING)]).shown(".2g") for name in names),
            )
            for uavs in sizes(rows, BEGINNING)
            if uavs != REFERENCE.uavs
        ],
    )


def fits(rows: Sequence[Row]) -> list[str]:
    """A row for each number of points: the difference of two fits; and the exponent of the points."""
    fitted = [row for row in rows if row["flight"] == FIT]
    numbers = sorted({row["points"] for row in fitted})
    apart = np.array([[row["phi_G_learned"] for row in fitted if row["points"] == points] for points in numbers])
    fall = statistics.mean(statistics.slopes(np.log(numbers), np.log(apart.T)))
    lines = [
        (f"{points:,} + {points:,}", str(len(own)), statistics.mean(own).shown(".2g"))
        for points, own in zip(numbers, apart, strict=True)
    ]
    return [
        *table(("points near the starts + in the box", "pairs of fits", NAMES["phi_G_learned"]), lines),
        "",
        f"Exponent of the number of points: {_interval(fall, '.2f')}.",
    ]


def beginnings(rows: Sequence[Row]) -> list[str]:
    """A row for each N: energy, alignment and collisions in the first 20 s."""
    lines = []
    for uavs in sizes(rows, BEGINNING):
        flights = of(rows, uavs, BEGINNING)
        pairs = uavs * (uavs - 1) / 2
        collisions = np.array([row["collisions"] for row in flights])
        lines.append(
            (
                f"{uavs:,}",
                statistics.mean([row["energy_J"] for row in flights]).shown(".3f"),
                statistics.mean([row["phi_A"] for row in flights]).shown(".3f"),
                statistics.mean(collisions).shown(",.1f"),
                statistics.mean(1e6 * collisions / pairs).shown(".0f"),
                f"{sum(row['lost'] for row in flights):,}",
            )
        )
    return table(("N", "E, J", "φ_A, m/s", "collisions", "of a million pairs", "UAVs lost"), lines)


def whole(rows: Sequence[Row]) -> list[str]:
    """A row for each N: time, energy, alignment and collisions of whole flights in which all UAVs stay."""
    lines = []
    for uavs in sizes(rows, METHOD):
        flights = of(rows, uavs, METHOD)
        names = {"time_s": ".1f", "energy_J": ".2f", "phi_A": ".3f", "collisions": ",.0f"}
        means = (statistics.mean([row[name] for row in flights]).shown(form) for name, form in names.items())
        arrived = f"{sum(row['arrived'] for row in flights):,} of {uavs * len(flights):,}"
        lines.append((f"{uavs:,}", *means, arrived))
    return table(("N", "T, s", "E, J", "φ_A, m/s", "collisions", "arrived"), lines)


def deviations(rows: Sequence[Row]) -> list[str]:
    """A row for each controller and N: what the last UAV has if it stays, and the change if it deviates."""
    lines = []
    for name in DEVIATIONS:
        for uavs in sizes(rows, name):
            cells = []
            for field in LAST:
                stays = statistics.mean([row[field] for row in of(rows, uavs, METHOD)])
                change = changed(rows, uavs, name, field)
                cells += [f"{stays.value:.1f}", f"{_interval(change, '+.1f')}, {better(change)}"]
            lines.append((f"`{name}`", f"{uavs:,}", *cells))
    return table(("flies", "N", *(cell for head in LAST.values() for cell in (f"{head}: stays", "change"))), lines)


def changed(rows: Sequence[Row], uavs: int, name: str, field: str) -> Estimate:
    """What the last UAV has with another controller, less what it has if it stays; paired by seed."""
    own, staying = ({row["seed"]: row[field] for row in of(rows, uavs, flight)} for flight in (name, METHOD))
    seeds = sorted(own.keys() & staying.keys())
    return statistics.difference([own[seed] for seed in seeds], [staying[seed] for seed in seeds])


def better(change: Estimate) -> str:
    """A change of cost, time or energy in a word; undecided if its 95 % interval contains 0."""
    if change.low <= 0.0 <= change.high:
        return "undecided"
    return "gains" if change.value < 0.0 else "loses"


def _interval(found: Estimate, form: str) -> str:
    return f"{found.value:{form}} [{found.low:{form}}, {found.high:{form}}]"
