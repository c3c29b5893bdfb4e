"""The page on the price of safety: its findings, tables and picture come from the record of a study."""

import itertools
from pathlib import Path

import msgspec
import numpy as np
import pytest

from meanflock.groundstation import statistics
from meanflock.studies.frontier import picture, record
from meanflock.studies.frontier.__main__ import main
from meanflock.studies.frontier.grid import Extent, Grid
from meanflock.studies.frontier.page import page
from meanflock.studies.leaderboard import flights, rows
from meanflock.studies.leaderboard.missions import Mission
from meanflock.studies.store import Store
from meanflock.swarm.errors import BadInput
from tests.studies.frontier.conftest import NEAR, following


@pytest.fixture(scope="module")
def docs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of pages, with the page of a study of two sizes and two losses."""
    folder = tmp_path_factory.mktemp("frontier")
    (folder / "near.toml").write_text(NEAR)
    (folder / "docs/results").mkdir(parents=True)
    extent = Extent(
        [Mission("near.toml")], rows.chosen(["orca", "plan", "vasarhelyi"]), (2, 4), (0.3, 0.5), (0.9, 0.95)
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(flights, "fly", following([]))
        grid = Grid(extent, 0, None, 94001, ("event", "event-r2", "event-r4", "tick"))
        grid.fly(1, lambda _done, _total: None, Store(folder / "out")).write(folder / "out")
        main([str(folder / "out")], folder / "docs")
    return folder / "docs"


def test_every_number_of_the_page_is_that_of_the_flights(docs) -> None:
    found = record.read(docs / "results/frontier.json")
    text = (docs / "price-of-safety.md").read_text()
    orca, more, *_ = found.cells
    first, last = orca.reached[-1], more.reached[-1]
    kbit = np.array(orca.policy("event-r2").confirmation.kbit)
    assert first.kbit == pytest.approx(kbit.mean())
    ends = f"({first.kbit_low:,.1f}…{first.kbit_high:,.1f})"
    assert f"| `orca` | 30 | {kbit[:29].mean():,.1f} (" in text
    assert f"{kbit.mean():,.1f} {ends}, `event-r2` |" in text
    assert f"30 % lost: `orca` {kbit.mean():,.0f} kbit (`event-r2`)" in text
    other = next(cell for cell in found.of("near.toml", 2) if (cell.row, cell.outage) == ("vasarhelyi", 0.3))
    ratio = statistics.ratio(kbit, other.policy("event-r2").confirmation.kbit)
    assert f" times `vasarhelyi` ({ratio.low:.2f}…{ratio.high:.2f})" in text
    assert f"`orca`, 2 UAVs: × {last.kbit / first.kbit:.1f}" in text
    assert "`plan`, 2 UAVs, 30 and 50 % lost: 90 % and 95 % free (best: 0/10 of the first flights, by `silent`)" in text
    assert "`plan` reaches 0 of 8 targets." in text
    flights = sum(
        len(policy.search.free) + len(policy.confirmation.free) for cell in found.cells for policy in cell.policies
    )
    assert f"{flights:,} flights of `orca`, `plan` and `vasarhelyi` on `near.toml`, with 2 and 4 UAVs" in text
    assert f"code {found.code}" in text
    named = [one.policy for cell in found.cells for one in cell.reached if one]
    assert f"`event-r2` {named.count('event-r2')}" in text
    assert "the cheapest safe one nowhere: `event` and `tick`" in text
    assert "a probability of at most 1 %, for each cell and target" in text
    tried = [
        [sum(one.search.free[:10]) for one in cell.policies[:-1] if len(one.search.free) > 2] for cell in found.cells
    ]
    falls = [second < first for each in tried for first, second in itertools.pairwise(each)]
    assert f"of {len(falls)} pairs of policies next to each other" in text
    assert f"among the first 10 in {sum(falls)}." in text
    assert "90 %: 29 flights, 0 may fail; 95 %: 59 flights, 0 may fail" in text
    assert f"a probability of only {100 * 0.99**59:.0f} %" in text
    assert max(map(len, text.partition("## Fewest bits")[0].splitlines())) < 1000
    findings = text.partition("\n1. ")[2].partition("![")[0]
    assert len(findings.split()) < 300  # one screen


def test_the_page_is_written_again_from_its_results(docs) -> None:
    before = (docs / "price-of-safety.md").read_text()
    (docs / "price-of-safety.md").unlink()
    main(["--page"], docs)
    assert (docs / "price-of-safety.md").read_text() == before
    assert "](pictures/frontier/near.png)" in before
    assert [path.name for path in (docs / "pictures/frontier").iterdir()] == ["near.png"]
    with pytest.raises(BadInput, match="or --page"):
        main([], docs)


def test_a_picture_has_a_line_for_each_controller_and_crosses_where_a_target_was_never_reached(docs) -> None:
    found = record.read(docs / "results/frontier.json")
    made = picture.draw(found, "near.toml")
    assert len(made.axes) == 4  # two targets, two sizes
    for ax in made.axes:
        lines = [line for line in ax.get_lines() if len(line.get_xdata()) == 2 and line.get_marker() != "x"]
        assert len(lines) == 3
        crosses = [line for line in ax.get_lines() if line.get_marker() == "x" and len(line.get_xdata())]
        assert [list(line.get_xdata()) for line in crosses] == [[30.0, 50.0]]  # plan
        low, high = ax.get_ylim()
        assert sum(low <= tick <= high for tick in ax.get_yticks()) >= 2
    assert [label.get_text() for label in made.axes[-1].get_xticklabels()] == ["30", "50"]
    (legend,) = made.legends
    assert [text.get_text() for text in legend.get_texts()] == ["orca", "plan", "vasarhelyi", "never reached"]


def test_a_page_of_a_target_that_nothing_reached_says_so(docs) -> None:
    found = record.read(docs / "results/frontier.json")
    silent = msgspec.structs.replace(found, cells=[cell for cell in found.cells if cell.row == "plan"])
    text = page(silent)
    assert "**Never reached**: `plan`, 2 UAVs" in text
    assert "fewest bits that show" not in text.partition("![")[0]
    picture.draw(silent, "near.toml")
