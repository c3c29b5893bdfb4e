"""Text of docs/price-of-safety.md: findings of a record, a picture, tables, method, and negative results."""

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

from meanflock.results import statistics
from meanflock.studies import equal_bits
from meanflock.studies.frontier import terminal
from meanflock.studies.frontier.policies import SILENT
from meanflock.studies.frontier.record import FrontierCell, FrontierRecord, PolicyRecord, Reached
from meanflock.studies.frontier.sampling import SamplingPlan
from meanflock.studies.frontier.search import ARRIVES, PILOT
from meanflock.studies.markdown import table

PICTURES = "pictures/frontier"
NOT_CONFIRMED = "not confirmed"
SINCE = (
    "**Since 1.0**: all flights have other seeds, and `orca` is again the cheapest in every comparison. The fewest "
    "bits are less certain than their intervals, which are of one policy: of the 48 targets that controllers that "
    "share reached in 1.0, 29 are reached with the same bits within 5 %, 17 with 0.63 to 1.90 times as many, nearly "
    "always because another policy is the cheapest that passes, and two are no longer reached, `vasarhelyi` with 64 "
    "UAVs and half of the broadcasts lost. Of 31 differences at equal bits 28 are found again, 3 are undecided now, "
    "and 13 are new; none is reversed."
)


def page(record: FrontierRecord) -> str:
    """The whole page, with a place for the ranking of `equal_bits`."""
    first, *others = record.missions()
    parts = [
        "# The price of safety, in bits",
        f"{_question(record)} {coverage(record)}",
        SINCE,
        "\n".join(f"{number}. {finding}" for number, finding in enumerate(findings(record), 1)),
        _picture(first),
        "## Fewest bits",
        "Mean kbit of the confirmation with the ends of its 95 % interval, and the policy. Where a target was never "
        "reached: the best share of free flights in the survey.",
        *(part for mission in record.missions() for part in _tables(record, mission)),
        *(_picture(mission) for mission in others),
        "## Ranking at equal bits",
        f"{equal_bits.BEGIN}\n{equal_bits.END}",
        "## Method",
        *method(record),
        "## What did not help, and what this does not show",
        "\n".join(f"- {result}" for result in negative(record)),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def coverage(record: FrontierRecord) -> str:
    """A sentence on the extent of the grid and the flights."""
    flights = sum(
        len(policy.search.free) + len(policy.confirmation.free) for cell in record.cells for policy in cell.policies
    )
    losses = _list([f"{100 * loss:g}" for loss in _losses(record.cells)])
    rows = _list([f"`{name}`" for name in _names(record)])
    return (
        f"{flights:,} flights of {rows} on {_list([f'`{mission}`' for mission in record.missions()])}, with "
        f"{_list(list(map(str, record.sizes())))} UAVs and {losses} % of the broadcasts lost; code {record.code}."
    )


# -- findings ----------------------------------------------------------------------------------------------------------


def findings(record: FrontierRecord) -> list[str]:
    """One sentence or two for each thing that the record shows, for the first mission."""
    (mission, *_), target = record.missions(), len(record.targets) - 1
    return [
        *_cheapest(record, mission, target),
        *_of_loss(record, mission, target),
        *_of_density(record, mission, target),
        _never(record, mission),
        *_without_radio(record, mission),
    ]


def _cheapest(record: FrontierRecord, mission: str, target: int) -> Iterator[str]:
    """The cheapest controller that shares, for each number of UAVs and each loss."""
    for uavs in record.sizes():
        texts = []
        for loss in _losses([cell for cell in record.cells_of(mission, uavs) if not _is_silent(cell)]):
            shown = _shown(record, mission, uavs, loss, target)
            if not shown:
                texts.append(f"none reaches it with {100 * loss:g} % lost")
                continue
            cell, *others = shown
            least = cell.reached[target]
            assert least is not None
            text = f"{100 * loss:g} % lost: `{cell.row}` {least.kbit:,.0f} kbit (`{least.policy}`)"
            if others:
                ratio = statistics.ratio(_confirmed(record, cell, target), _confirmed(record, others[0], target))
                text += f", {ratio.value:.2f} times `{others[0].row}` ({ratio.low:.2f}…{ratio.high:.2f})"
            texts.append(text)
        if texts:
            shown_by = f"the fewest bits that show {record.targets[target].name} free flights"
            yield (
                f"**With {uavs} UAVs on `{mission}`, {shown_by}**, beside the next controller by bits (95 % interval): "
                f"{'; '.join(texts)}."
            )


def _of_loss(record: FrontierRecord, mission: str, target: int) -> Iterator[str]:
    """Bits at the largest loss beside those at the smallest."""
    texts = []
    for name in _names(record):
        for uavs in record.sizes():
            own = [cell for cell in record.cells_of(mission, uavs) if cell.row == name and not _is_silent(cell)]
            ends = [cell.reached[target] for cell in sorted(own, key=lambda cell: cell.outage)]
            if len(ends) > 1 and ends[0] is not None and ends[-1] is not None:
                texts.append(f"`{name}`, {uavs} UAVs: × {ends[-1].kbit / ends[0].kbit:.1f}")
    losses = _losses(record.cells_of(mission))
    if texts:
        yield (
            f"**What loss costs**: bits with {100 * losses[-1]:g} % of the broadcasts lost beside those with "
            f"{100 * losses[0]:g} %. {'; '.join(texts)}."
        )


def _of_density(record: FrontierRecord, mission: str, target: int) -> Iterator[str]:
    """Bits of a UAV in the largest swarm beside those in the smallest."""
    few, many = record.sizes()[0], record.sizes()[-1]
    factors: dict[str, list[float]] = {}
    for cell in record.cells_of(mission, few):
        own = next((other for other in record.cells_of(mission, many) if _same(cell, other)), None)
        if few == many or own is None or _is_silent(cell):
            continue
        ends = cell.reached[target], own.reached[target]
        if ends[0] is not None and ends[1] is not None:
            factors.setdefault(cell.row, []).append(ends[1].kbit / many / (ends[0].kbit / few))
    texts = [f"`{row}` × {_range(each)}" for row, each in factors.items()]
    if texts:
        yield f"**What density costs**: bits of one UAV among {many} beside one among {few}. {'; '.join(texts)}."


def _never(record: FrontierRecord, mission: str) -> str:
    losses: dict[tuple[str, str], list[str]] = {}  # by the words before and after them
    for cell in record.cells_of(mission):
        missed = [each.name for each, reached in zip(record.targets, cell.reached, strict=True) if reached is None]
        if missed:
            share, name = terminal.best(cell, record.survey).split(" ", 1)
            best = f"{_list(missed)} free (best: {share} of the first flights, by `{name}`)"
            losses.setdefault((f"`{cell.row}`, {cell.uavs} UAVs", best), []).append(f"{100 * cell.outage:g}")
    texts = [f"{where}, {_list(lost)} % lost: {best}" for (where, best), lost in losses.items()]
    return f"**Never reached**: {'; '.join(texts) or 'nothing; every controller reaches every target'}."


def _without_radio(record: FrontierRecord, mission: str) -> Iterator[str]:
    silent = [cell for cell in record.cells_of(mission) if _is_silent(cell)]
    for name in dict.fromkeys(cell.row for cell in silent):
        own = [cell for cell in silent if cell.row == name]
        reached = [one for cell in own for one in cell.reached if one is not None]
        plans = [f"{kbit:,.1f}" for kbit in sorted({one.kbit for one in reached})]
        bits = f", with the {_list(list(dict.fromkeys(plans)))} kbit of the mission plan" if plans else ""
        yield (
            f"**Without a broadcast after take-off**: `{name}` reaches {len(reached)} of "
            f"{len(own) * len(record.targets)} targets{bits}."
        )


# -- method and negative results ---------------------------------------------------------------------------------------


def method(record: FrontierRecord) -> list[str]:
    """Paragraphs on how the numbers were found."""
    plans = "; ".join(f"{one.name}: {one.flights} flights, {one.failures} may fail" for one in record.targets)
    most = max(len(cell.policies) for cell in record.cells)
    error = max(cell.error for cell in record.cells)
    return [
        "A flight is free if there was no collision and no obstacle was hit, as on the "
        "[leaderboard](leaderboard.md); UAVs that arrived, never arrive or are lost count. Bits are the payload of "
        "all UAVs until the last arrival. They include the mission plan, which every swarm broadcasts before "
        "take-off. An outage is the probability that a broadcast of 64 bits fails, set by `radio.target_snr_db`.",
        "All missions have the paper's radio, whose slots last 50 µs and where each link has a band of its own "
        "(`fdma`). In one band 25 UAVs fly the same flights: [states in one band](round-cost.md#states-in-one-band).",
        "A target is reached if the one-sided 95 % bound of Clopper and Pearson of the share of free flights reaches "
        f"it. The plans are fixed before the first flight ({plans}), and no policy is accepted before the last flight "
        "of its plan. A policy is dropped as soon as its plan can no longer accept it, which changes no answer.",
        f"All policies of a cell fly {PILOT} flights, which order them by their bits. From the cheapest on, each "
        f"flies {record.survey} flights whatever happens in them, so that shares compare, and goes on if its plan is "
        "still open. Nothing assumes that more bits are safer. The cheapest of many policies on the same seeds looks "
        "better than it is, so each accepted policy flies its plan again on fresh seeds (from "
        f"{record.confirmation_seed} on; the search uses those from {record.first_seed} on). Bounds and bits are of "
        "these flights alone. A policy below the target is accepted twice with a probability of at most 0.25 %, so a "
        f"search among {most} policies names one with a probability of at most {100 * error:.2g} %, for each cell and "
        f"target. A policy under which fewer than {100 * ARRIVES:g} % of the UAVs arrive is not named.",
        "All cells use the same seeds, so they are not independent of each other. Flights are complete: one that "
        "stopped at its first collision would save little time and leave no bits to compare. `meanflock frontier` "
        "repeats all of it ([commands](cli.md#the-frontier-fewest-bits-for-safe-flights)); "
        "[results/frontier.json](results/frontier.json) has every flight, and its fields are in "
        "[data](data.md#frontierjson). Written by `python -m meanflock.studies.frontier`.",
    ]


def negative(record: FrontierRecord) -> list[str]:
    """Policies that did not help, and the limits of the method."""
    sharing = [cell for cell in record.cells if not _is_silent(cell)]
    last = record.targets[-1]
    longest = SamplingPlan(last.share, last.failures, last.flights)
    named = Counter(one.policy for cell in sharing for one in cell.reached if one is not None)
    flown = dict.fromkeys(policy.name for cell in sharing for policy in cell.policies)
    unnamed = [f"`{name}`" for name in flown if not named[name]]
    refuted = sum(policy.verdicts.count(NOT_CONFIRMED) for cell in record.cells for policy in cell.policies)
    accepted = refuted + sum(named.values())
    results = []
    if unnamed:
        results.append(f"Policies that were the cheapest safe one nowhere: {_list(unnamed)}.")
    if named:
        counts = _list([f"`{name}` {number}" for name, number in named.most_common()])
        results.append(f"How often each policy was the cheapest safe one, by cell and target: {counts}.")
        results.append(
            f"Of {accepted} policies that the search accepted, {refuted} failed on fresh seeds: so much the choice "
            "among policies flatters."
        )
    if factors := [*_of_every_tick(sharing)]:
        results.append(
            f"With a state every tick {_range(factors)} times as many bits are sent as with the cheapest safe policy."
        )
    return [
        *results,
        *_not_safer(record, sharing),
        *_compared(record, sharing, "event-v", "event-r4"),
        "The bits are the fewest that these flights show, among these policies. A cheaper policy that was dropped "
        f"may be safe enough: a share of 99 % passes the plan for {last.name} with a probability of only "
        f"{100 * longest.acceptance(0.99):.0f} %.",
        "Constants of the controllers are those of the leaderboard, tuned on seeds 1 to 10 with one policy and the "
        "radio of each mission. None was tuned for a policy or an outage.",
    ]


def _not_safer(record: FrontierRecord, cells: Sequence[FrontierCell]) -> Iterator[str]:
    """How often the dearer one of two policies next to each other by bits had fewer free flights in the survey."""
    falls = []
    for cell in cells:
        free = [sum(policy.search.free[: record.survey]) for policy in _surveyed(record, cell)]
        falls += [second < first for first, second in pairwise(free)]
    if falls:
        yield (
            f"More bits are not always safer: of {len(falls)} pairs of policies next to each other by their bits, the "
            f"dearer one had fewer free flights among the first {record.survey} in {sum(falls)}."
        )


def _compared(record: FrontierRecord, cells: Sequence[FrontierCell], *names: str) -> Iterator[str]:
    """Two policies in the cells in which both flew the survey: their free flights and their bits."""
    both = [cell for cell in cells if {*names} <= {policy.name for policy in _surveyed(record, cell)}]
    if not both:
        return
    texts = []
    for name in names:
        flown = [cell.policy(name).search for cell in both]
        free = sum(sum(each.free[: record.survey]) for each in flown)
        kbit = [value for each in flown for value in each.kbit[: record.survey]]
        texts.append(f"`{name}` {free} of {len(kbit)} flights free at {sum(kbit) / len(kbit):,.0f} kbit")
    yield f"What to send beside how often, in the {len(both)} cells where both flew the survey: {'; '.join(texts)}."


def _surveyed(record: FrontierRecord, cell: FrontierCell) -> list[PolicyRecord]:
    return [policy for policy in cell.policies if len(policy.search.free) >= record.survey]


def _of_every_tick(cells: Sequence[FrontierCell]) -> Iterator[float]:
    """Bits of the policy `tick` beside those of the policy that was named, in the flights of the pilot."""
    for cell in cells:
        reached = cell.reached[-1]
        if reached is not None and any(policy.name == "tick" for policy in cell.policies):
            every, least = (cell.policy(name).search.kbit[:PILOT] for name in ("tick", reached.policy))
            yield sum(every) / sum(least)


# -- parts -------------------------------------------------------------------------------------------------------------


def _question(record: FrontierRecord) -> str:
    targets = _list([target.name for target in record.targets])
    return (
        "How many bits must a swarm send so that its flights are shown to be free of collisions? For each "
        "controller, loss and number of UAVs: the fewest bits at which a one-sided 95 % bound of the share of free "
        f"flights reaches {targets}."
    )


def _tables(record: FrontierRecord, mission: str) -> Iterator[str]:
    for uavs in record.sizes():
        if cells := record.cells_of(mission, uavs):
            head = ("row", "lost, %", *(f"{target.name} free" for target in record.targets), "best share")
            lines = [
                (
                    f"`{cell.row}`",
                    f"{100 * cell.outage:g}",
                    *map(_reached, cell.reached),
                    "" if all(cell.reached) else terminal.best(cell, record.survey),
                )
                for cell in cells
            ]
            yield f"### `{mission}`, {uavs} UAVs"
            yield "\n".join(table(head, lines))


def _reached(one: Reached | None) -> str:
    if one is None:
        return "never reached"
    return f"{one.kbit:,.1f} ({one.kbit_low:,.1f}…{one.kbit_high:,.1f}), `{one.policy}`"


def _picture(mission: str) -> str:
    about = f"Fewest bits against the share of lost broadcasts on {mission}, a line a controller"
    return f"![{about}]({PICTURES}/{Path(mission).stem}.png)"


def _shown(record: FrontierRecord, mission: str, uavs: int, loss: float, target: int) -> list[FrontierCell]:
    """Cells of a loss whose controllers broadcast and reached a target, from the cheapest to the dearest."""
    cells = [cell for cell in record.cells_of(mission, uavs) if cell.outage == loss and not _is_silent(cell)]
    found = [(one.kbit, cell) for cell in cells if (one := cell.reached[target]) is not None]
    return [cell for _, cell in sorted(found, key=lambda each: each[0])]


def _confirmed(record: FrontierRecord, cell: FrontierCell, target: int) -> list[float]:
    """Payloads of the flights that confirmed a target, kbit, in the order of their seeds."""
    reached = cell.reached[target]
    return [] if reached is None else cell.policy(reached.policy).confirmation.kbit[: record.targets[target].flights]


def _same(cell: FrontierCell, other: FrontierCell) -> bool:
    return (cell.row, cell.outage) == (other.row, other.outage)


def _is_silent(cell: FrontierCell) -> bool:
    return [policy.name for policy in cell.policies] == [SILENT]


def _names(record: FrontierRecord) -> list[str]:
    return list(dict.fromkeys(cell.row for cell in record.cells))


def _losses(cells: Sequence[FrontierCell]) -> list[float]:
    return sorted({cell.outage for cell in cells})


def _range(values: Sequence[float]) -> str:
    least, most = f"{min(values):.1f}", f"{max(values):.1f}"
    return least if least == most else f"{least}…{most}"


def _list(texts: Sequence[str]) -> str:
    return " and ".join([", ".join(texts[:-1]), texts[-1]]) if len(texts) > 1 else "".join(texts)
