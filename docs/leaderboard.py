"""Writes leaderboard.md, the leaderboard of the shipped controllers, and its pictures, from results/leaderboard.json.
Also writes the tables of controllers.md on learning together.

meanflock leaderboard --out out/leaderboard    # 30 seeds of every row in every mission
python docs/leaderboard.py out/leaderboard     # takes its leaderboard.json; without a folder: the page again
python docs/leaderboard.py docs/results out/more    # adds the rows of another folder, which replace those of its names
"""

import argparse
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from meanflock.net import process
from meanflock.results import statistics
from meanflock.results.statistics import Estimate
from meanflock.studies.leaderboard import board, maps, markdown, pareto
from meanflock.studies.leaderboard.board import Board, Standing
from meanflock.studies.leaderboard.measures import BY_KEY
from meanflock.studies.markdown import replaced, table

HERE = Path(__file__).parent
PAGE, RESULTS = Path(__file__).with_suffix(".md"), HERE / "results" / "leaderboard.json"
PICTURES = HERE / "pictures" / "leaderboard"
CONTROLLERS = HERE / "controllers.md"
GAINS, MAPS, END = "<!-- gains: docs/leaderboard.py -->", "<!-- maps: docs/leaderboard.py -->", "<!-- end of table -->"
LEARNING = {  # column of the table of gains → row of the leaderboard
    "never learns": "fed-lspi-never",
    "alone": "fed-lspi-alone",
    "shares gains": "fed-lspi",
    "shares gains with neighbours": "fed-lspi-neighbours",
    "shares data": "fed-lspi-data",
}
LEARNED_IN = ("paper", "unknown", "gusts", "lossy")  # missions of the table of gains
MAPPING = ("straight", "windmap-alone", "windmap-weights", "windmap-precision", "windmap-measurements")
TOLD = ("paper", "unknown", "windy")  # missions in which learning together is compared with learning alone
NO_GAIN = 0.01  # of the whole: less is nothing gained


def main(arguments: Sequence[str] | None = None) -> None:
    """Write record, page and pictures.

    Raises:
        BadInput: the folders have no boards, or boards that cannot be joined.
    """
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument(
        "out", nargs="*", type=Path, help="folders of leaderboards to join; none: write the page again"
    )
    given = options.parse_args(arguments)
    found = board.joined([board.read(out / board.FILE) for out in given.out or [RESULTS.parent]])
    found.write(RESULTS.parent)
    PAGE.write_text(page(found), encoding="utf-8")
    CONTROLLERS.write_text(controllers(found, CONTROLLERS.read_text(encoding="utf-8")), encoding="utf-8")
    pareto.write(found.courses, PICTURES)
    maps.write(found.courses, PICTURES)
    for drawing in PICTURES.glob("*.svg"):
        drawing.unlink()
    print(PAGE)


def page(found: Board) -> str:
    """The whole page."""
    plots = {
        course.name: f"pictures/leaderboard/{course.name}.png"
        for course in found.courses
        if any(map(pareto.drawn, course.standings))
    }
    areas = {course.name: f"pictures/leaderboard/{course.name}-map.png" for course in found.courses}
    return markdown.markdown(found, plots, areas, introduction(found))


def controllers(found: Board, text: str) -> str:
    """The page on controllers `text` with its tables on learning together."""
    for begin, lines in ((GAINS, gains(found)), (MAPS, wind_maps(found))):
        text = replaced(text, begin, END, ["", *lines, ""])
    return text


def gains(found: Board) -> list[str]:
    """Tracking costs of `fed-lspi` by what it shares, a row a mission."""

    def cells(mission: str, show: Callable[[Standing], str]) -> list[str]:
        rows = (_row(found, mission, name) for name in LEARNING.values())
        return ["not flown" if row is None else show(row) for row in rows]

    lines = [(f"`{mission}`", *cells(mission, _tracking)) for mission in LEARNED_IN]
    bits = cells(LEARNED_IN[0], lambda row: f"{row.cells['kbit'].mean:,.0f}")
    return table(("", *LEARNING), [*lines, (f"kbit in `{LEARNED_IN[0]}`, states included", *bits)])


def wind_maps(found: Board) -> list[str]:
    """Costs of flying through the wind, a row for each thing that is shared."""
    rows = [row for name in MAPPING if (row := _row(found, "windmap", name)) is not None]
    lines = []
    for row in rows:
        difference = "–" if row is rows[0] else _less(row, rows[0], "cost_J").shown(".2f")
        lines.append((f"`{row.name}`", _interval(row, "cost_J"), difference, f"{row.cells['kbit'].mean:,.0f}"))
    return table(("", "cost, J", f"beside `{MAPPING[0]}`, paired, J", "kbit"), lines)


# -- the first lines -------------------------------------------------------------------------------------------------


SINCE = (
    "**Since 1.0**: all rows flew again with other seeds, and missions in space joined, `sphere` and `layers`. The "
    "four findings stand. Of 62 bold marks 55 stand, 7 are gone and 3 are new, all between close rows. Of 207 rows "
    "whose flights were all free of collisions 199 are so again; the others have a collision or a hit in one "
    "flight, but for `mfg-fast-ecbf` on `windy` and `obstacles` and `fed-lspi-alone` on `windmap`, in three each. "
    "`orca` is no longer without a collision in every mission: on `crowd` it has one in one flight of 30."
)


def introduction(found: Board) -> str:
    """What a reader should know before any table, with the numbers of this board."""
    parts = [
        truths(found),
        "Where learning together pays, and where it does not; each finding was expected before these seeds were flown:",
        "\n".join(f"{number}. {sentences}" for number, sentences in enumerate(findings(found), 1)),
        SINCE,
        f"{markdown.how_flown(found)} Constants were tuned on seeds 1 to 10 only. "
        "Written by `python docs/leaderboard.py` from [results/leaderboard.json](results/leaderboard.json), whose "
        "fields are in "
        "[data](data.md#leaderboardjson); the controllers are on [their page](controllers.md).",
    ]
    return "\n\n".join(parts)


def truths(found: Board) -> str:
    """What the paper's scenario needs of learning and radio."""
    plan, paper = _row(found, "paper", "plan"), _row(found, "paper", "mfgfl-hf")
    if plan is None or paper is None:
        return "The rows `plan` and `mfgfl-hf` were not flown in the mission `paper`."
    collided, beside = plan.cells["collisions_all"], paper.cells["collisions"]
    needs = "neither learning nor radio is needed" if collided.mean == 0.0 else "a plan alone is not free of collisions"
    free = f"{_free(plan)} flights without a collision"
    return (
        f"**On the paper's scenario, with a shared plan and a wind that everybody knows, {needs}.** `plan` learns "
        f"nothing, says nothing after take-off, and takes {_mean(plan, 'time_s')} s and {_mean(plan, 'energy_J')} J, "
        f"with {free}; the least energy for that time is "
        f"{plan.cells['energy_J'].mean - plan.cells['regret_J'].mean:.2f} J. The paper's `mfgfl-hf` takes "
        f"{_mean(paper, 'time_s')} s, {_mean(paper, 'energy_J')} J and {paper.cells['kbit'].mean:,.0f} kbit, and "
        f"{beside.mean:.1f} pairs collide on the way in a flight ({_free(paper)} flights are free of collisions)."
    )


def findings(found: Board) -> list[str]:
    """Four expectations, each with what the board says of it."""
    return [_federated_tracking(found), _shared_map(found), _identified_air(found), _paper_learner(found)]


def _federated_tracking(found: Board) -> str:
    """By the sign of the difference: single flights in which a UAV alone learns nonsense would own any mean."""
    sentences = []
    for mission, alone, together in _both(found, TOLD, "fed-lspi-alone", "fed-lspi"):
        if not {"tracking"} <= alone.cells.keys() & together.cells.keys():
            continue
        one, all_ = alone.column("tracking"), together.column("tracking")
        less = statistics.share(all_ < one)
        verdict = "confirmed" if less.low > 0.5 else "refuted" if less.high < 0.5 else "undecided"
        sentences.append(
            f"`{mission}` {np.median(one):.3g} → {np.median(all_):.3g}, "
            f"less in {int((all_ < one).sum())} of {less.n} flights ({verdict})"
        )
    return (
        "**Learning a tracking value function from nothing pays when gains are averaged.** Tracking cost a UAV, each "
        f"for itself → averaged, medians of the flights: {'; '.join(sentences) or 'not flown'}."
    )


def _shared_map(found: Board) -> str:
    rows = {name: _row(found, "windmap", name) for name in MAPPING}
    flown = {name: row for name, row in rows.items() if row is not None and "cost_J" in row.cells}
    if len(flown) < len(MAPPING):
        return "**A wind map pays if shared, and data pay more than models**: not all of its rows were flown."
    costs = ", ".join(
        f"`{name}` {_interval(row, 'cost_J')} ({row.cells['kbit'].mean:,.0f} kbit)" for name, row in flown.items()
    )
    saved = _less(flown["straight"], flown["windmap-measurements"], "cost_J")
    averaged = _less(flown["windmap-alone"], flown["windmap-weights"], "cost_J")
    data = _less(flown["windmap-weights"], flown["windmap-measurements"], "cost_J")
    return (
        f"**A wind map pays if shared, and data pay more than models.** Energy and 0.05 J a second: {costs}. That "
        f"measurements shared save beside flying straight: {_verdict(saved)}; that averaging maps saves beside keeping "
        f"them: {_verdict(averaged)}; that measurements save beside averaged maps: {_verdict(data)}."
    )


def _identified_air(found: Board) -> str:
    """Confirmed where what is saved of time and energy is told to be less than one part in a hundred."""
    sentences = []
    for mission, alone, together in _both(found, TOLD, "rls-alone", "rls"):
        saved = [_share_saved(alone, together, key) for key in ("time_s", "energy_J")]
        sentences.append(
            f"`{mission}` {_interval(alone, 'time_s')} s, {_interval(alone, 'energy_J')} J → "
            f"{_interval(together, 'time_s')} s, {_interval(together, 'energy_J')} J ({_no_gain(saved)})"
        )
    return (
        "**Identifying drag and wind together does not pay**: what three averaged numbers get wrong less, the feedback "
        f"makes up for anyway. `rls`, each for itself → averaged: {'; '.join(sentences) or 'not flown'}."
    )


def _share_saved(first: Standing, second: Standing, key: str) -> Estimate:
    """The part of a mean that the second saves."""
    mean = first.column(key).mean()
    return statistics.difference(first.column(key) / mean, second.column(key) / mean)


def _no_gain(saved: Sequence[Estimate]) -> str:
    """Of an expectation that nothing is saved: by whether the 95 % intervals lie below one part in a hundred."""
    if any(each.bounded and each.low > NO_GAIN for each in saved):
        return "refuted"
    return "confirmed" if all(each.bounded and each.high < NO_GAIN for each in saved) else "undecided"


def _paper_learner(found: Board) -> str:
    sentences = []
    for speed, kappa in (("", "0.01"), ("-fast", "0.02")):
        for _, alone, together in _both(found, ("paper",), f"mfg{speed}-ecbf", f"mfgfl-h{speed}-ecbf"):
            sentences.append(
                f"at κ = {kappa} {_interval(alone, 'energy_J')} → {_interval(together, 'energy_J')} J at "
                f"{together.cells['kbit'].mean / alone.cells['kbit'].mean:.1f} times the bits (that it saves: "
                f"{_verdict(_less(alone, together, 'energy_J'))})"
            )
    return (
        "**Whether the paper's learner gains by federation depends on how hurried it is.** `mfg` → `mfgfl-h`, both "
        f"behind the filter: {'; '.join(sentences) or 'not flown'}."
    )


# -- numbers in words ------------------------------------------------------------------------------------------------


def _row(found: Board, mission: str, name: str) -> Standing | None:
    rows: Sequence[Standing] = [
        row for course in found.courses if course.name == mission for row in course.standings if row.name == name
    ]
    return rows[0] if rows and rows[0].cells else None


def _both(found: Board, missions: Sequence[str], *names: str) -> Iterator[tuple[str, Standing, Standing]]:
    """The missions that two rows have flown, and those."""
    for mission in missions:
        alone, together = (_row(found, mission, name) for name in names)
        if alone is not None and together is not None:
            yield mission, alone, together


def _less(first: Standing, second: Standing, key: str) -> Estimate:
    """How much less the second is, paired by seed."""
    return statistics.difference(first.column(key), second.column(key))


def _verdict(less: Estimate) -> str:
    """Of an expected saving: by its 95 % interval."""
    if not less.bounded or less.low <= 0.0 <= less.high:
        return "undecided"
    return "confirmed" if less.low > 0.0 else "refuted"


def _mean(row: Standing, key: str) -> str:
    return f"{row.cells[key].mean:.2f}" if row.cells[key].mean < 10 else f"{row.cells[key].mean:.1f}"


def _tracking(row: Standing) -> str:
    """Mean with its interval, and the median: a few UAVs that learn nonsense own any mean."""
    flights = row.column("tracking")
    return f"{statistics.mean(flights).shown(',.0f')} ({np.median(flights):,.0f})"


def _interval(row: Standing, key: str) -> str:
    return row.cells[key].estimate.shown(".2f" if BY_KEY[key].unit == "J" else ".1f")


def _free(row: Standing) -> str:
    cell = row.cells["free"]
    return f"{round(cell.mean * cell.n)} of {cell.n}"


if __name__ == "__main__":
    process.main(main)
