"""The findings and tables of docs/price-of-accuracy.md."""

import math
from collections.abc import Mapping, Sequence

from meanflock.results import statistics
from meanflock.results.statistics import Estimate
from meanflock.studies import published
from meanflock.studies.markdown import table, with_parts
from research.price_of_accuracy.expected import EXPECTED, Expected
from research.price_of_accuracy.flights import (
    ALL,
    APPS,
    FIRST_SEED,
    LOSSES,
    MEASURES,
    PAPER,
    STRAGGLERS,
    WAYS,
    WHO,
    WIDTH,
    WINDY,
    Flight,
    MissionWay,
    cases,
)

PAGE = published.DOCS / "price-of-accuracy.md"
RESULTS = published.DOCS / "results" / "price_of_accuracy.json"
UNITS = {"mbit": "bits", "airtime_s": "airtime", "energy_J": "joules", "seconds": "time"}


def page(text: str, code: str, rows: Sequence[Flight]) -> str:
    """The page `text` with the findings and tables of these flights."""
    found = {case: [one for one in rows if (one["mission"], one["way"]) == case] for case in cases()}
    parts = {
        "flights": [f"{len(rows)} flights with seeds from {FIRST_SEED} on. {published.flown_by(code)}"],
        "findings": _findings(found),
        "expected": _expectations(found),
        **{mission: _costs(found, mission) for mission in ALL},
        "ratios": _ratios(found),
    }
    return with_parts(text, parts)


Found = Mapping[MissionWay, Sequence[Flight]]


def ratio(found: Found, case: MissionWay, against: MissionWay, measure: str) -> Estimate:
    """A measure of a case as a multiple of that of another, paired by seed: the geometric mean.

    A flight that never reached 90 % would have cost more than it did. So there is no upper bound if one of the case did
    not, and no lower bound if one of the other case did not.
    """
    own, other = found[case], found[against]
    logarithms = [[math.log(one[measure]) for one in arm] for arm in (own, other)]
    change = statistics.difference(*logarithms)
    low = math.exp(change.low) if _all_reached(other) else 0.0
    high = math.exp(change.high) if _all_reached(own) else math.inf
    return Estimate(math.exp(change.value), low, high, change.n)


def verdict(change: Estimate, low: float, high: float) -> str:
    """Whether a ratio is between two bounds: confirmed or refuted by its whole 95 % interval, else undecided."""
    if low <= change.low and change.high <= high:
        return "confirmed"
    return "refuted" if change.high < low or change.low > high else "undecided"


def _word(change: Estimate) -> str:
    """Less, more, or undecided."""
    if change.low <= 1.0 <= change.high:
        return "undecided"
    return "less" if change.high < 1.0 else "more"


def _all_reached(arm: Sequence[Flight]) -> bool:
    return all(one["reached"] for one in arm)


def _reached(arm: Sequence[Flight]) -> str:
    return f"{sum(one['reached'] for one in arm)} of {len(arm)}"


def _shown(change: Estimate) -> str:
    return f"× {change.value:.2f} [{change.low:.2f}, {change.high:.2f}]".replace("inf", "∞")


def _mean(arm: Sequence[Flight], measure: str, digits: str = ".1f") -> str:
    """A mean with its interval; at least that much if a flight never reached 90 %."""
    shown = statistics.mean([one[measure] for one in arm]).shown(digits)
    return shown if _all_reached(arm) else f"≥ {shown}"


def _costs(found: Found, mission: str) -> list[str]:
    """A row for each way in a mission."""
    rows = []
    for case in (one for one in cases() if one.mission == mission):
        arm = found[case]
        parts = (statistics.mean([one[f"{part}_J"] for one in arm]).value for part in ("flying", "radio", "training"))
        rows.append(
            (
                case.way,
                f"{arm[0]['rate']:g}",
                _reached(arm),
                _mean(arm, "rounds"),
                _mean(arm, "seconds"),
                _mean(arm, "mbit", ".2f"),
                _mean(arm, "airtime_s", ".2f"),
                f"{_mean(arm, 'energy_J')} ({' + '.join(f'{part:.1f}' for part in parts)})",
            )
        )
    head = ("way", "rate", "reached", "rounds", "time, s", "Mbit", "airtime, s", "J (flying + radio + training)")
    return table(head, rows)


def _ratios(found: Found) -> list[str]:
    """A row for each way that is compared with another, in each mission."""
    rows = []
    for case in cases():
        if against := WAYS[case.way].against:
            changes = [ratio(found, case, MissionWay(case.mission, against), measure) for measure in MEASURES]
            cells = [f"{_shown(change)}, {_word(change)}" for change in changes]
            sooner, later = _sooner(found[case], found[MissionWay(case.mission, against)])
            rows.append(
                (case.mission, f"{case.way} / {against}", str(changes[0].n), *cells, f"{sooner} sooner, {later} later")
            )
    return table(("mission", "ways", "n", *MEASURES.values(), "pairs"), rows)


def _expectations(found: Found) -> list[str]:
    """A row for each expectation and what became of it."""
    rows = []
    for one in EXPECTED:
        change = _change(found, one)
        where = one.case.mission if one.case.mission == one.against.mission else " / ".join((WINDY, PAPER))
        bounds = f"{one.low:g} to {one.high:g}".replace("0 to", "at most").replace(" to inf", " or more")
        rows.append(
            (one.words, where, MEASURES[one.measure], bounds, _shown(change), verdict(change, one.low, one.high))
        )
    return table(("expected", "mission", "measure", "× expected", "× found", "verdict"), rows)


def _findings(found: Found) -> list[str]:
    """What the flights say, a sentence for each mission, question, and the expectations."""
    arm = found[MissionWay(PAPER, "leader")]
    means = {name: statistics.mean([one[name] for one in arm]).value for name in MEASURES}
    lines = [
        f"**With a leader on `paper`**, 90 % cost {means['mbit']:.1f} Mbit, {means['airtime_s']:.2f} s on the air, "
        f"{means['energy_J']:.0f} J and {means['seconds']:.0f} s; {_reached(arm)} flights reached it.",
        f"**The smallest means** of the ways without stragglers: {'; '.join(_cheapest(found, one) for one in ALL)}.",
    ]
    for question in (WHO, LOSSES, WIDTH, STRAGGLERS, APPS):
        compared = [name for name, way in WAYS.items() if way.question == question and way.against]
        lines.append(f"**{question}** {' '.join(_beside(found, name) for name in compared)}")
    verdicts = [(one.words, verdict(_change(found, one), one.low, one.high)) for one in EXPECTED]
    counts = {word: [words for words, given in verdicts if given == word] for word in ("confirmed", "refuted")}
    refuted = f": {'; '.join(dict.fromkeys(counts['refuted']))}" if counts["refuted"] else ""
    lines.append(
        f"**Of {len(verdicts)} [expectations](#what-was-expected)** {len(counts['confirmed'])} are confirmed, "
        f"{len(verdicts) - sum(map(len, counts.values()))} undecided and {len(counts['refuted'])} refuted{refuted}."
    )
    return [f"{number}. {line}" for number, line in enumerate(lines, 1)]


def _cheapest(found: Found, mission: str) -> str:
    """The ways with the smallest means in a mission, of those of which every flight reached 90 %."""
    rivals = [case for case in cases() if case.mission == mission and WAYS[case.way].question in (WHO, LOSSES, WIDTH)]
    rivals = [case for case in rivals if _all_reached(found[case])]
    best: dict[str, list[str]] = {}
    for measure, unit in UNITS.items():
        means = {case.way: statistics.mean([one[measure] for one in found[case]]).value for case in rivals}
        best.setdefault(min(means, key=means.__getitem__), []).append(unit)
    return f"on `{mission}` " + " and ".join(f"*{way}* ({', '.join(units)})" for way, units in best.items())


def _beside(found: Found, name: str) -> str:
    """A sentence on a way beside the way that it is compared with."""
    way, places = WAYS[name], dict[str, list[str]]()
    for mission in way.missions:
        places.setdefault(_said(found, MissionWay(mission, name)), []).append(f"`{mission}`")
    said = "; ".join(f"on {' and '.join(where)} {words}" for words, where in places.items())
    return f"{name[0].upper()}{name[1:]} beside {way.against}: {said}."


def _change(found: Found, expected: Expected) -> Estimate:
    return ratio(found, expected.case, expected.against, expected.measure)


def _said(found: Found, case: MissionWay) -> str:
    """What a way costs in a mission beside the way that it is compared with."""
    against = MissionWay(case.mission, WAYS[case.way].against)
    never = [one.way for one in (case, against) if not any(flight["reached"] for flight in found[one])]
    if never:
        return f"no flight with {' or '.join(never)} reached 90 %"
    parts, undecided = [], []
    for measure, unit in UNITS.items():
        change = ratio(found, case, against, measure)
        if _word(change) == "undecided":
            undecided.append(unit)
        else:
            parts.append(f"{change.value:.2f} times the {unit}")
    if not parts:
        sooner, later = _sooner(found[case], found[against])
        return f"undecided (sooner in {sooner} of {len(found[case])} pairs, later in {later})"
    return ", ".join([*parts, *([f"{' and '.join(undecided)} undecided"] if undecided else [])])


def _sooner(own: Sequence[Flight], other: Sequence[Flight]) -> tuple[int, int]:
    """Number of pairs of flights of a seed in which the first reached 90 % sooner, and later, than the second."""
    pairs = list(zip(own, other, strict=True))
    return sum(_is_sooner(*pair) for pair in pairs), sum(_is_sooner(*reversed(pair)) for pair in pairs)


def _is_sooner(first: Flight, second: Flight) -> bool:
    return bool(first["reached"]) and (not second["reached"] or first["seconds"] < second["seconds"])
