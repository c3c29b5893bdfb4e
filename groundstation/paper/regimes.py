"""Which claims hold where: every setting of the map judged flight by flight, and the best of them by a written rule.

The score of a setting is the sum, over the measured claims about S0 that one flight a method decides, of the share of
its flights in which the claim holds. Claims about bits and residuals do not count: what is searched for is another
flight. A comparison with a method that the map does not fly is left out.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import msgspec
import pyarrow as pa
import pyarrow.compute as pc

from meanflock.groundstation.paper import claims
from meanflock.groundstation.paper.claims import Claim
from meanflock.groundstation.paper.search import MULTINOMIAL
from meanflock.groundstation.paper.single import has_single_flights, single_flights
from meanflock.groundstation.paper.tables import Results
from meanflock.groundstation.paper.view import View

MAP, FOUND = "map", "found"
FEW_ARRIVE = 0.5  # share of the UAVs of mfgfl-hf that never arrive: such a setting is on the map, and not chosen
SLOW_M_S = 60.0  # L_v from which steering is slow: the swarm drifts with the wind first


@dataclass(frozen=True)
class Place:
    """A setting of the map: of every claim, the flights it holds in and those flown, [k, n]."""

    setting: str
    held: Mapping[str, tuple[int, int]]
    never_arrived: float  # share of the UAVs of mfgfl-hf

    @property
    def score(self) -> float:
        """Claims held, each by its share of flights."""
        return sum(k / n for k, n in self.held.values())

    def key(self, name: str, default: float) -> float:
        """The value of a scenario key in the setting."""
        values = dict(part.split("=") for part in self.setting.split(", ") if part)
        return float(values.get(name, default))

    @property
    def multinomial(self) -> bool:
        """Whether the polynomials keep their coefficients."""
        return MULTINOMIAL in self.setting

    @property
    def as_printed(self) -> bool:
        """Whether rounds are those the paper prints: twice as long for both models as for one."""
        return "federation.period" not in self.setting


def places(results: Results, experiment: str = MAP) -> list[Place]:
    """Every setting of the map that was flown, in the order of the design."""
    runs = results.runs.filter(pc.equal(results.runs["experiment"], experiment))
    found = []
    for setting in dict.fromkeys(runs["setting"].to_pylist()):
        own = runs.filter(pc.equal(runs["setting"], setting))
        view = View.of(_as_s0(own, results))
        flown = set(own["method"].to_pylist())
        held = {}
        for claim in judged(flown):
            counts = single_flights(view, claim)
            held[claim.id] = counts or (0, len(set(own["seed"].to_pylist())))  # a flight that has no such number
        subject = own.filter(pc.equal(own["method"], "mfgfl-hf"))
        arrived = pc.sum(subject["arrived"]).as_py() / max(1, pc.sum(subject["uavs"]).as_py())
        found.append(Place(setting, held, 1.0 - arrived))
    return found


def judged(flown: set[str]) -> list[Claim]:
    """The claims that count, each with the comparisons the methods flown allow."""
    kept = []
    for claim in claims.load():
        if claim.kind != "measured" or not has_single_flights(claim) or not _of_motion(claim):
            continue
        checks = []
        for check in claim.check:
            subject, against = _of(check.subject, flown), _of(check.against, flown)
            if subject and (against or not check.against):
                checks.append(msgspec.structs.replace(check, subject=subject, against=against))
        if checks:
            kept.append(msgspec.structs.replace(claim, check=tuple(checks)))
    return kept


def best(found: list[Place], count: int = 10) -> list[Place]:
    """The settings of the highest scores in which most arrive; among equal ones those where more do, then the earlier."""
    most = [place for place in found if place.never_arrived < FEW_ARRIVE]
    return sorted(most, key=lambda place: (-place.score, place.never_arrived))[:count]


def slow(found: list[Place]) -> Place:
    """paper-slow: the best of slow steering, with rounds as printed and coefficients of one."""
    there = [p for p in found if not p.multinomial and p.as_printed and p.key("learner.kappa", 0.01) > 0]
    return best([p for p in there if p.key("learner.velocity_scale", 20.0) >= SLOW_M_S], 1)[0]


def printed(found: list[Place]) -> Place:
    """paper-printed: the best with the polynomial's coefficients and L_s = ½‖s‖², with rounds as printed."""
    there = [p for p in found if p.multinomial and p.as_printed and p.key("learner.kappa", 0.01) == 0]
    return best(there, 1)[0]


def _of_motion(claim: Claim) -> bool:
    return not any(check.metric.startswith(("bits", "hjb", "fpk")) for check in claim.check)


def _of(names: tuple[str, ...], flown: set[str]) -> tuple[str, ...]:
    return tuple(name for name in names if name in flown)


def _as_s0(runs: pa.Table, results: Results) -> Results:
    for name, value in (("experiment", "s0"), ("setting", "")):
        place = runs.schema.get_field_index(name)
        runs = runs.set_column(place, runs.schema.field(name), pa.array([value] * runs.num_rows, pa.string()))
    return Results(runs, *(table.slice(0, 0) for table in (results.series, results.trajectories, results.weights)))
