"""The map of regimes: the claims that hold in each setting, flight by flight, and the best settings by rule.

The score of a setting is the sum, over the measured claims about S0 that one flight a method decides, of the share of
its flights in which the claim holds. Claims about bits and residuals do not count: what is searched for is another
flight. A comparison with a method that the map does not fly is left out."""

from collections.abc import Mapping
from dataclasses import dataclass

import msgspec

from research.reproduction import claims
from research.reproduction.claims import Claim
from research.reproduction.grid import MULTINOMIAL
from research.reproduction.tables import View
from research.reproduction.verdict import counted, has_single_flights

MAP, FOUND = "map", "found"
FEW_ARRIVE = 0.5  # share of the UAVs of mfgfl-hf that never arrive: such a setting is on the map, and not chosen
SLOW_M_S = 60.0  # L_v from which steering is slow: the swarm drifts with the wind first


@dataclass(frozen=True)
class MapPoint:
    """A setting of the map: for every claim the flights in which it holds, and all flights, [k, n]."""

    setting: str
    held: Mapping[str, tuple[int, int]]
    never_arrived: float  # share of the UAVs of mfgfl-hf

    @property
    def score(self) -> float:
        """Number of claims that hold, each counted by its share of flights."""
        return sum(k / n for k, n in self.held.values())

    def key(self, name: str, default: float) -> float:
        """The value of a scenario key in the setting."""
        values = dict(part.split("=") for part in self.setting.split(", ") if part)
        return float(values.get(name, default))

    @property
    def multinomial(self) -> bool:
        """Returns whether the polynomials keep their coefficients."""
        return MULTINOMIAL in self.setting

    @property
    def as_printed(self) -> bool:
        """Returns whether rounds are as printed: twice as long for both models as for one."""
        return "federation.period" not in self.setting


def places(view: View, experiment: str = MAP) -> list[MapPoint]:
    """Every setting of the map that was flown, in the order of the tables."""
    runs, found = view.runs.where(experiment=experiment), []
    if not len(runs):
        return []
    claimed = judged(set(runs.distinct("method")), experiment)
    for setting in dict.fromkeys(runs["setting"].tolist()):
        own = runs.where(setting=setting)
        flights = len(own.distinct("seed"))
        single = View(own, view.series, view.trajectories, view.weights, {})
        # A flight that has not the number a claim is about, as none of a UAV that diverged, is one it does not hold in.
        held = {claim.id: counted(single, claim) or (0, flights) for claim in claimed}
        subject = own.where(method="mfgfl-hf")
        found.append(MapPoint(setting, held, 1.0 - float(subject["arrived"].sum() / subject["uavs"].sum())))
    return found


def judged(flown: set[str], experiment: str = MAP) -> list[Claim]:
    """The claims that count, each reduced to the comparisons between flown methods."""
    result = []
    for claim in claims.load():
        if claim.kind != "measured" or not has_single_flights(claim) or not _of_motion(claim):
            continue
        checks = []
        for check in claim.check:
            subject, against = _of(check.subject, flown), _of(check.against, flown)
            if subject and (against or not check.against):
                checks.append(msgspec.structs.replace(check, subject=subject, against=against, experiment=experiment))
        if checks:
            result.append(msgspec.structs.replace(claim, check=tuple(checks)))
    return result


def best(found: list[MapPoint], count: int = 10) -> list[MapPoint]:
    """The settings with the highest scores in which most UAVs arrive; ties go to more arrivals, then to the earlier."""
    most = [place for place in found if place.never_arrived < FEW_ARRIVE]
    return sorted(most, key=lambda place: (-place.score, place.never_arrived))[:count]


def slow(found: list[MapPoint]) -> MapPoint:
    """paper-slow: the best of slow steering, with rounds as printed and coefficients of one."""
    allowed = [p for p in found if not p.multinomial and p.as_printed and p.key("learner.kappa", 0.01) > 0]
    return best([p for p in allowed if p.key("learner.velocity_scale", 20.0) >= SLOW_M_S], 1)[0]


def printed(found: list[MapPoint]) -> MapPoint:
    """paper-printed: the best with the polynomial's coefficients and L_s = ½‖s‖², with rounds as printed."""
    allowed = [p for p in found if p.multinomial and p.as_printed and p.key("learner.kappa", 0.01) == 0]
    return best(allowed, 1)[0]


def _of_motion(claim: Claim) -> bool:
    return not any(check.metric.startswith(("bits", "hjb", "fpk")) for check in claim.check)


def _of(names: tuple[str, ...], flown: set[str]) -> tuple[str, ...]:
    return tuple(name for name in names if name in flown)
