"""Figures of studies: categories and numbers of a sweep, and the marks and the legend of a Pareto front."""

from collections.abc import Iterator
from itertools import product
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import same_color
from matplotlib.container import ErrorbarContainer
from matplotlib.figure import Figure

from meanflock.results.plots import plotstyle
from meanflock.results.plots.comparison import plot_sweep, point_looks
from meanflock.results.plots.tradeoff import DOMINATED, FRONT, UNDECIDED, TradeoffPoint, plot_tradeoff
from meanflock.results.statistics import exact, mean

ENERGIES = (1.0, 9.0)  # of the flights of a point: their interval reaches far below 0


def sweep(values: tuple[Any, ...], columns: int = 2) -> Figure:
    """A sweep of two methods, two flights each."""
    figures = {"t_avg_censored_s": 30.0, "payload_bits": {"total": 100.0}, "phi_A": 0.5}
    flights = [figures | {"energy_mean_J": energy} for energy in ENERGIES]
    return plot_sweep(["radio.access", "method"], dict.fromkeys(product(values, ("hjb", "orca")), flights), columns)


def points(figure: Figure, panel: int) -> Iterator[ErrorbarContainer]:
    return (each for each in figure.axes[panel].containers if isinstance(each, ErrorbarContainer))


def test_categories_are_points_side_by_side_and_numbers_are_joined() -> None:
    figure = sweep(("fdma", "tdma", "csma"))
    places = []
    for line, _, bars in points(figure, 1):
        assert line.get_linestyle() == "None"
        assert len(bars) == 1  # the interval
        places.append(np.asarray(line.get_xdata()))
    assert [text.get_text() for text in figure.axes[2].get_xticklabels()] == ["fdma", "tdma", "csma"]
    assert 0.05 < places[1][0] - places[0][0] < 0.5
    low, high = figure.axes[1].get_xlim()
    assert low < places[0][0] - 0.3
    assert places[1][-1] + 0.3 < high
    assert [handle.get_linestyle() for handle in figure.legends[0].get_lines()] == ["None", "None"]
    assert [line.get_linestyle() for line, _, _ in points(sweep((1.0, 2.0)), 1)] == ["-", "-"]


def test_no_axis_of_a_sweep_reaches_below_zero_and_the_caption_says_of_how_many_flights() -> None:
    figure = sweep((1.0, 2.0))
    assert mean(ENERGIES).low < -10.0
    low, high = figure.axes[1].get_ylim()
    assert -0.1 * high < low <= 0.0
    assert high > mean(ENERGIES).high
    assert figure.get_supxlabel() == "mean and 95 % interval over 2 flights"


def test_swept_numbers_are_the_ticks_unless_they_are_close() -> None:
    ticks = [text.get_text() for text in sweep((0.1, 0.2, 0.35)).axes[2].get_xticklabels()]
    assert ticks == ["0.1", "0.2", "0.35"]
    assert len(sweep((1, 2, 1000)).axes[2].get_xticks()) > 3


def test_a_point_has_the_colour_of_its_line_and_a_mark_and_a_dash_for_its_value() -> None:
    names, values = ["radio.access", "method"], ("fdma", "tdma", "csma")
    looks = point_looks(names, product(values, ("hjb", "orca")))
    lines = {str(handle.get_label()): handle for handle in sweep(values).legends[0].get_lines()}
    for (_, method), look in looks.items():
        assert look.colour == lines[method].get_color()
    for own in ([look for (_, each), look in looks.items() if each == method] for method in ("hjb", "orca")):
        assert len({look.marker for look in own}) == len({look.dash for look in own}) == len(values)
    alone = point_looks(["method"], [("hjb",), ("orca",)])
    assert alone == {(name,): look for name, look in plotstyle.looks(["hjb", "orca"]).items()}
    swept = point_looks(names, product(values, ["hjb"]))
    assert len({look.colour for look in swept.values()}) == len(values)


PLACED = [
    TradeoffPoint("method=orca", plotstyle.look("orca"), mean([1.0, 2.0]), mean([5.0, 6.0]), UNDECIDED),
    TradeoffPoint("method=hjb", plotstyle.look("hjb"), exact(2.0), exact(4.0), FRONT),
    TradeoffPoint("method=mfg", plotstyle.look("mfg"), exact(9.0), exact(9.0), DOMINATED),
]


@pytest.mark.parametrize("columns", [1, 2])
def test_a_front_has_the_same_marks_in_its_legend_which_says_what_they_mean(columns: int) -> None:
    figure = plot_tradeoff(PLACED, "payload (bits)", "loss", columns)
    (legend,) = figure.legends
    shown = dict(zip([text.get_text() for text in legend.get_texts()], legend.get_lines(), strict=True))
    meanings = ["filled: on the front", "hollow: undecided", "pale: dominated"]
    assert list(shown) == ["method=hjb", "method=orca", "method=mfg", *meanings]
    assert {handle.get_linestyle() for handle in shown.values()} == {"None"}
    drawn = [line for line, _, _ in points(figure, 0)]
    for point, line in zip(PLACED, drawn, strict=True):
        assert line.get_marker() == shown[point.label].get_marker() == point.look.marker
        assert same_color(line.get_markerfacecolor(), shown[point.label].get_markerfacecolor())
        assert line.get_alpha() == shown[point.label].get_alpha()
        assert (line.get_alpha() < 1.0) == (point.place == DOMINATED)
    assert same_color(drawn[0].get_markerfacecolor(), "white")
    crowd = [*PLACED, *[PLACED[2]._replace(label=f"method={number}") for number in range(10)]]
    (legend,) = plot_tradeoff(crowd, "payload (bits)", "loss", columns).legends  # dominated points have no names there
    assert [text.get_text() for text in legend.get_texts()] == ["method=hjb", "method=orca", *meanings]
    only = plot_tradeoff(PLACED[1:2], "payload (bits)", "loss", columns)
    assert [text.get_text() for text in only.legends[0].get_texts()] == ["method=hjb", meanings[0]]


@pytest.mark.parametrize("columns", [1, 2])
@pytest.mark.parametrize("length", [5, 90])
def test_a_legend_of_many_long_names_fits_and_leaves_the_panel_its_height(columns: int, length: int) -> None:
    many = [
        point._replace(label=f"{number} {'name ' * (length // 5)}".strip())
        for number in range(12)
        for point in PLACED[:1]
    ]
    one, figure = (plot_tradeoff(placed, "payload (bits)", "loss", columns) for placed in (PLACED[1:2], many))
    heights = []
    for each in (one, figure):
        each.draw_without_rendering()
        heights.append(each.axes[0].get_window_extent().height)
        box = each.legends[0].get_window_extent()
        assert box.x0 >= 0.0
        assert box.x1 <= each.bbox.width
        assert box.y0 >= each.axes[0].get_window_extent().y1
    assert heights[1] == pytest.approx(heights[0], rel=0.15)
