"""The page of the published leaderboard: its sentences follow from its numbers."""

import numpy as np
import pytest

from meanflock.studies.leaderboard import board
from meanflock.studies.leaderboard.board import Board, Course, Standing
from meanflock.studies.leaderboard.measures import BY_KEY
from tests.pages import script_of

SEEDS = 12


def standing(name: str, **means: float) -> Standing:
    """A row with these means, and the same small spread in each; what is not named is 0."""
    spread = np.linspace(-1.0, 1.0, SEEDS)
    columns = {key: np.zeros(SEEDS) for key in BY_KEY}
    columns |= {key: mean + 0.01 * mean * spread for key, mean in means.items()}
    columns |= {"arrived": np.ones(SEEDS), "free": np.full(SEEDS, float(not means.get("collisions_all")))}
    values = {key: [board.rounded(value) for value in column] for key, column in columns.items()}
    return Standing(name, name, "", {}, False, board.cells(columns), {"state": 1.0}, values)


def made(*courses: tuple[str, list[Standing]]) -> Board:
    return Board(
        1,
        "0",
        "code",
        list(range(SEEDS)),
        [Course(name, name, "", 25, 300.0, rows, {}, [], []) for name, rows in courses],
    )


@pytest.fixture(scope="module")
def script():
    return script_of("leaderboard")


PLAN = {"time_s": 79.6, "energy_J": 9.12, "regret_J": 0.14, "kbit": 3.2}
PAPER = {
    "time_s": 173.7,
    "energy_J": 21.4,
    "regret_J": 12.4,
    "collisions": 16.6,
    "collisions_all": 30.0,
    "kbit": 1643.0,
}


def test_the_first_lines_have_the_numbers_of_the_board(script) -> None:
    said = script.truths(made(("paper", [standing("plan", **PLAN), standing("mfgfl-hf", **PAPER)])))
    assert "neither learning nor radio is needed" in said
    for number in ("79.6 s", "9.12 J", "12 of 12 flights", "8.98 J", "173.7 s", "21.4 J", "1,643 kbit", "16.6 pairs"):
        assert number in said
    crashes = standing("plan", **PLAN, collisions_all=0.5)
    assert "a plan alone is not free" in script.truths(made(("paper", [crashes, standing("mfgfl-hf", **PAPER)])))


def test_findings_are_decided_by_the_numbers(script) -> None:
    for together, verdict in (
        (9.5, "less in 12 of 12 flights (confirmed)"),
        (500.0, "less in 0 of 12 flights (refuted)"),
    ):
        rows = [standing("fed-lspi-alone", tracking=213.0), standing("fed-lspi", tracking=together)]
        said = script.findings(made(("paper", rows)))[0]
        assert f"`paper` 213 → {together:.3g}" in said
        assert verdict in said
    costs = {"straight": 22.7, "windmap-alone": 22.0, "windmap-weights": 22.5, "windmap-precision": 19.7}
    rows = [standing(name, cost_J=cost, kbit=1.0) for name, cost in (costs | {"windmap-measurements": 19.1}).items()]
    said = script.findings(made(("windmap", rows)))[1]
    for words in ("flying straight: confirmed", "keeping them: refuted", "averaged maps: confirmed"):
        assert f"beside {words}" in said
    assert "not all of its rows were flown" in script.findings(made(("windmap", rows[1:])))[1]
    for energy, verdict in ((9.12, "confirmed"), (8.9, "refuted"), (9.0288, "undecided")):
        rows = [standing("rls-alone", time_s=79.6, energy_J=9.12), standing("rls", time_s=79.6, energy_J=energy)]
        said = script.findings(made(("unknown", rows)))[2]
        assert f"J → 79.6 ± 0.3 s, {energy:.2f} ± 0.04 J ({verdict})" in said
    costs = {"mfg-ecbf": 21.9, "mfgfl-h-ecbf": 17.8, "mfg-fast-ecbf": 18.7, "mfgfl-h-fast-ecbf": 19.6}
    rows = [standing(name, energy_J=cost, kbit=100.0 * (1 + name.startswith("mfgfl"))) for name, cost in costs.items()]
    said = script.findings(made(("paper", rows)))[3]
    assert "at κ = 0.01 21.90 ± 0.09 → 17.80 ± 0.07 J at 2.0 times the bits (that it saves: confirmed)" in said
    assert "(that it saves: refuted)" in said


def test_the_page_is_that_of_its_results(script) -> None:
    assert script.PAGE.read_text(encoding="utf-8") == script.page(board.read(script.RESULTS)), (
        "run `python docs/leaderboard.py`"
    )
