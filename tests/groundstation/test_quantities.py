"""Each quantity has one name, and it is the same wherever a person reads it."""

import io
import json
import re
from pathlib import Path
from typing import Any

import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.console import Console

from groundstation import blueprint as look
from groundstation import plots, quantities
from groundstation.paper import figures_grids
from groundstation.progress import summary_table
from groundstation.quantities import FIELDS, Quantity
from groundstation.run import Options, fly
from swarm.messages import DIAGNOSTICS, SWARM_COLUMNS
from swarm.scenario import load

ROOT = Path(__file__).parents[2]
QUANTITIES = {value for value in vars(quantities).values() if isinstance(value, Quantity)}
ABANDONED = ("misalignment", "velocity alignment", "interaction cost", "motion energy", "weight spread")


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The folders of short flights, by method."""
    out = tmp_path_factory.mktemp("runs")
    options = Options(out=out, in_process=True, record=False, quiet=True)
    methods = ("hjb", "mfgfl-hf", "offline")
    return {method: fly(load(None, method=method, uavs=9, duration=45.0), options).folder for method in methods}


def plain(title: str) -> str:
    """A title without its letter, line breaks and the dollars of mathematics."""
    words = re.sub(r"^\(\w\) ", "", title.replace("\n", " "))
    return words.replace("$", "").replace(r"\phi_", "φ_")


def titles(made: Figure) -> dict[str, Axes]:
    return {plain(ax.get_title(loc="left")): ax for ax in made.axes if ax.get_title(loc="left")}


def test_every_field_that_has_a_name_exists(runs: dict[str, Path]) -> None:
    summary = json.loads((runs["mfgfl-hf"] / "summary.json").read_text())
    columns = {*SWARM_COLUMNS, *DIAGNOSTICS, "energy_J", "weight_spread"}
    of_the_study = {"t_avg_censored_s", "energy_trip_mean_J", "phi_A_tavg", "phi_C_tavg"}
    assert set(FIELDS) - of_the_study - columns <= {*summary, "payload_bits.total"}
    assert set(FIELDS.values()) == QUANTITIES
    assert len({quantity.name for quantity in QUANTITIES}) == len(QUANTITIES)


def test_the_notation_has_every_name_with_its_unit_and_fields() -> None:
    section = (ROOT / "docs/notation.md").read_text(encoding="utf-8").split("## Names")[1].split("\n## ")[0]
    rows = {}
    for row in section.splitlines():
        if row.startswith("| "):
            name, unit, fields, _ = [cell.strip() for cell in row.replace("\\|", "¦").strip("|").split("|")]
            rows[name.replace("¦", "|")] = (unit, set(re.findall(r"`(\w+)`", fields)))
    for quantity in QUANTITIES:
        unit, fields = rows[quantity.name]
        assert unit == (quantity.unit or "1")
        mine = {field.removesuffix(".total") for field, known in FIELDS.items() if known is quantity}
        assert fields & mine, quantity
        assert not fields - mine, quantity


def test_the_summarys_table_uses_them(runs: dict[str, Path]) -> None:
    summary: dict[str, Any] = json.loads((runs["mfgfl-hf"] / "summary.json").read_text())
    console = Console(file=io.StringIO(), width=200)
    console.print(summary_table(summary))
    table = console.file.getvalue()  # type: ignore[attr-defined]
    for field in ("t_avg_s", "energy_mean_J", "phi_A", "phi_C_distinct", "collisions", "distance_mean_m", "outages"):
        assert f"│ {FIELDS[field].name}" in table
    assert re.search(r"alignment φ_A +│ +[\d.]+ │ m/s, lower is better", table)


def test_the_plots_of_a_recording_use_them() -> None:
    for plot, quantity in (
        (look.ENERGY, quantities.ENERGY),
        (look.SPEED, quantities.SPEED),
        (look.BITS, quantities.PAYLOAD),
        (look.ALIGNMENT, quantities.ALIGNMENT),
        (look.RISK, quantities.RISK_PRINTED),
        (look.FAILURES, quantities.OUTAGES),
        (look.FAILURES, quantities.COLLISIONS),
        (look.HJB, quantities.HJB_RESIDUAL),
        (look.FPK, quantities.FPK_RESIDUAL),
        (look.PHI_G, quantities.INTERACTION),
        (look.SPREAD, quantities.SPREAD),
    ):
        assert quantity.name in plot.title
    assert look.ALIGNMENT.title == "alignment φ_A, m/s, lower is better"


def test_plots_use_them(runs: dict[str, Path]) -> None:
    panels = list(titles(plots.plot_run(runs["mfgfl-hf"])["curves"]))
    for quantity in (quantities.ENERGY, quantities.SPEED, quantities.HJB_RESIDUAL, quantities.FPK_RESIDUAL):
        assert any(panel.startswith(quantity.name) for panel in panels), quantity
    assert "alignment φ_A, lower is better" in panels
    for compared in (plots.COMPARED, figures_grids.CRITERIA):
        for field, title in compared:
            assert title == FIELDS[field].remarked


@pytest.mark.parametrize("name", ["README.md", "docs/notation.md", "docs/cli.md", "docs/communication.md"])
def test_no_document_uses_a_name_of_before(name: str) -> None:
    text = (ROOT / name).read_text(encoding="utf-8").lower()
    assert not [word for word in ABANDONED if word in text]


def test_no_code_of_the_ground_station_does() -> None:
    for path in (ROOT / "groundstation").rglob("*.py"):
        text = path.read_text(encoding="utf-8").lower()
        assert not [word for word in ABANDONED if f'"{word}' in text], path


# -- what the plots of a run show ------------------------------------------------------------


@pytest.mark.parametrize(
    ("method", "value", "density"),
    [
        ("offline", ["offline learns no value"], ["offline learns no density"]),
        ("hjb", [], ["hjb learns no density"]),
        ("mfgfl-hf", [], []),
    ],
)
def test_a_learners_panel_says_what_is_not_learned(
    method: str, value: list[str], density: list[str], runs: dict[str, Path]
) -> None:
    panels = titles(plots.plot_run(runs[method])["curves"])
    said = [[text.get_text() for text in panels[f"{known.name}, mean"].texts] for known in LEARNERS]
    assert said == [value, density]


LEARNERS = (quantities.HJB_RESIDUAL, quantities.FPK_RESIDUAL)


def test_every_line_of_a_panel_with_two_has_a_label_and_the_legend_keeps_off_them(runs: dict[str, Path]) -> None:
    made = plots.plot_run(runs["offline"])["curves"]
    panels = titles(made)
    made.canvas.draw()
    for title, labels in (
        ("collision risk φ_C", ["with self-pairs", "distinct pairs"]),
        ("arrived and collisions", ["arrived, of 9", "collisions (pairs)"]),
    ):
        ax = panels[title]
        assert [each.get_label() for each in ax.lines] == labels
        legend = ax.get_legend()
        assert legend is not None
        assert [text.get_text() for text in legend.get_texts()] == labels
        bottom = ax.transData.inverted().transform(legend.get_window_extent().p0)[1]
        assert bottom > max(each.get_ydata().max() for each in ax.lines)  # type: ignore[union-attr]


def test_the_goal_is_a_ring_over_the_paths_and_in_the_legend(runs: dict[str, Path]) -> None:
    made = plots.plot_run(runs["mfgfl-hf"])["paths"]
    ax = made.axes[0]
    rings = [patch for patch in ax.patches if tuple(getattr(patch, "center", ())) == (0.0, 0.0)]
    assert [ring.get_radius() for ring in rings] == [5.0, 5.0]  # type: ignore[attr-defined]
    assert min(ring.get_zorder() for ring in rings) > max(line.get_zorder() for line in (*ax.lines, *ax.collections))
    assert "goal, 5 m" in [text.get_text() for text in made.legends[0].get_texts()]


def test_paths_of_a_method_blind_to_others_have_no_colour_of_the_interaction(runs: dict[str, Path]) -> None:
    assert len(plots.plot_run(runs["mfgfl-hf"])["paths"].axes) == 2  # with a colour bar
    assert len(plots.plot_run(runs["offline"])["paths"].axes) == 1
