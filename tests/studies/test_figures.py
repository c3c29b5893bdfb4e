"""Figures of studies: categories and numbers of a sweep, and the marks and the legend of a Pareto front."""

from collections.abc import Callable, Iterator
from itertools import product
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import same_color
from matplotlib.container import ErrorbarContainer
from matplotlib.figure import Figure
from matplotlib.markers import CARETDOWN, CARETLEFT, CARETRIGHT

from meanflock.results.plots import plotstyle
from meanflock.results.plots.comparison import plot_compare, plot_points, plot_sweep, point_looks
from meanflock.results.plots.learning import plot_learning
from meanflock.results.plots.tradeoff import DOMINATED, FRONT, UNDECIDED, TradeoffPoint, plot_tradeoff
from meanflock.results.points import labels
from meanflock.results.quantities import COMPARED
from meanflock.results.statistics import exact, mean

ENERGIES = (1.0, 9.0)  # of the flights of a point: their interval reaches far below 0


def sweep(values: tuple[Any, ...], columns: int = 2) -> Figure:
    """A sweep of two methods, two flights each."""
    points = dict.fromkeys(product(values, ("hjb", "orca")), flights(ENERGIES))
    return plot_sweep(["radio.access", "method"], points, columns)


def flights(energies: tuple[float, ...]) -> list[dict[str, Any]]:
    """Summaries that differ in their energy."""
    same = {"t_avg_censored_s": 30.0, "payload_bits": {"total": 100.0}, "phi_A": 0.5, "phi_C_distinct": 0.0}
    same |= {"collisions": 0, "arrived": 2, "uavs": 2}
    return [same | {"energy_mean_J": energy} for energy in energies]


def points(figure: Figure, panel: int) -> Iterator[ErrorbarContainer]:
    return (each for each in figure.axes[panel].containers if isinstance(each, ErrorbarContainer))


def test_categories_are_points_side_by_side_and_numbers_are_joined() -> None:
    figure = sweep(("fdma", "tdma", "csma"))
    places = []
    for line, _, bars in points(figure, 1):
        assert line.get_linestyle() == "None"
        assert len(bars) == 1  # the interval
        places.append(np.asarray(line.get_xdata()))
    assert [text.get_text() for text in figure.axes[-1].get_xticklabels()] == ["fdma", "tdma", "csma"]
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
    caption = "mean and 95 % interval over 2 flights"
    assert figure.get_supxlabel() == f"{caption}; arrow: the interval goes on beyond the axis"
    arrows = [line for line in figure.axes[1].lines if line.get_marker() == CARETDOWN]
    (at,) = {tuple(line.get_ydata()) for line in arrows}
    assert len(arrows) == 4  # one for each point
    assert at == (low,)
    assert all(line.get_marker() != CARETDOWN for line in figure.axes[0].lines)


def test_intervals_side_by_side_have_arrows_where_the_axis_ends_and_a_caption_that_fits() -> None:
    figure = plot_compare({"hjb": flights(ENERGIES), "orca": flights((5.0, 5.1))}, columns=1)
    ax = figure.axes[1]
    arrows = [line for line in ax.lines if line.get_marker() in (CARETLEFT, CARETRIGHT)]
    assert [(*line.get_xdata(), *line.get_ydata()) for line in arrows] == [(ax.get_xlim()[0], 0)]
    figure.draw_without_rendering()
    (caption,) = (text for text in figure.texts if text.get_text() == figure.get_supxlabel())
    assert caption.get_window_extent().x0 >= 0.0
    assert caption.get_window_extent().x1 <= figure.bbox.width


@pytest.mark.parametrize("columns", [1, 2])
@pytest.mark.parametrize("count", [2, 5, 12])
def test_methods_side_by_side_fit_a_page_and_all_texts_fit_the_figure(columns: int, count: int) -> None:
    methods = ("a-controller-of-mine", *(f"m{number}" for number in range(1, count)))
    check_fits(plot_compare({method: flights(ENERGIES) for method in methods}, columns), columns)


@pytest.mark.parametrize("columns", [1, 2])
@pytest.mark.parametrize("values", [(1.0, 2.0), ("fdma", "tdma", "csma")])
def test_a_sweep_has_a_panel_for_each_compared_metric_and_fits_a_page(columns: int, values: tuple[Any, ...]) -> None:
    figure = sweep(values, columns)
    assert len(figure.axes) == len(COMPARED)
    check_fits(figure, columns)


def check_fits(figure: Figure, columns: int) -> None:
    """Titles and labels lie within the figure, which fits a page."""
    assert figure.get_figwidth() == plotstyle.WIDTHS_IN[columns]
    assert figure.get_figheight() < 10.0
    figure.draw_without_rendering()
    for ax in figure.axes:
        for text in (ax._left_title, ax.xaxis.label, ax.yaxis.label):
            if text.get_text():
                extent = text.get_window_extent()
                assert -1.0 <= extent.x0 < extent.x1 <= figure.bbox.width + 1.0, text.get_text()


def test_swept_numbers_are_the_ticks_unless_they_are_close() -> None:
    ticks = [text.get_text() for text in sweep((0.1, 0.2, 0.35)).axes[-1].get_xticklabels()]
    assert ticks == ["0.1", "0.2", "0.35"]
    assert len(sweep((1, 2, 1000)).axes[-1].get_xticks()) > 3


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


@pytest.mark.parametrize("looks", [
    lambda: plotstyle.looks(map(str, range(plotstyle.MOST_LOOKS))),
    lambda: plotstyle.looks([*plotstyle.LOOKS, *map(str, range(60))]),
    lambda: point_looks(["wind.sigma", "method"], product(range(14), ["hjb"])),
    lambda: point_looks(["wind.sigma", "method"], product(range(14), ["hjb", "orca"])),
    lambda: point_looks(["wind.sigma", "method"], product(range(2), map(str, range(14)))),
    lambda: point_looks(["wind.sigma", "method"], product(range(10), map(str, range(12)))),
], ids=["all", "papers", "values", "more values than dashes", "more lines than colours", "full"])  # fmt: skip
def test_no_two_looks_of_a_figure_are_equal(looks: Callable[[], dict[Any, plotstyle.MethodLook]]) -> None:
    found = looks().values()
    for part in ("dash", "marker"):
        assert len({(look.colour, getattr(look, part)) for look in found}) == len(found)


@pytest.mark.parametrize("swept", [["groups.b.method", "wind.sigma"], ["wind.sigma", "groups.b.method"]], ids=str)
@pytest.mark.parametrize("methods", [["hjb"], ["hjb", "mfg"]])
def test_a_sweep_of_the_method_of_a_group_has_a_line_for_all_controllers_of_a_flight(
    swept: list[str], methods: list[str]
) -> None:
    values = {"groups.b.method": ["orca", "bvc"], "wind.sigma": [0.1, 0.2]}
    place = swept.index("groups.b.method")
    grid = [(*point, f"{own}+{point[place]}") for point in product(*(values[key] for key in swept)) for own in methods]
    names = [*swept, "method"]
    figure = plot_points(names, dict.fromkeys(grid, flights(ENERGIES)))
    lines = {str(handle.get_label()): handle.get_color() for handle in figure.legends[0].get_lines()}
    assert sorted(lines) == sorted(f"{own}+{other}" for own in methods for other in ("orca", "bvc"))
    assert figure.axes[-1].get_xlabel() == "wind.sigma (m/s/√s)"
    assert {point: look.colour for point, look in point_looks(names, grid).items()} == {
        point: lines[point[-1]] for point in grid
    }
    assert labels(names, grid)[grid[0]] == f"{grid[0][-1]}, sigma=0.1"


def test_methods_of_a_group_alone_are_side_by_side() -> None:
    points = {(other, f"hjb+{other}"): flights(ENERGIES) for other in ("orca", "bvc")}
    ax = plot_points(["groups.b.method", "method"], points).axes[0]
    assert [text.get_text() for text in ax.get_yticklabels()] == ["hjb+orca", "hjb+bvc"]
    alike = [("orca", "bvc", "orca+bvc"), ("bvc", "orca", "orca+bvc")]  # `method` does not tell them apart
    assert len({*labels(["groups.a.method", "groups.b.method", "method"], alike).values()}) == 2


def learning(points: int, diagnostics: int, columns: int) -> Figure:
    """Learning curves of points with equal rounds."""
    names = [f"mean_of_number_{number}" for number in range(diagnostics)]
    rounds = [[{"round": number, **dict.fromkeys(names, number + seed)} for number in (1, 2, 3)] for seed in range(2)]
    figure = plot_learning(
        ["wind.sigma"], dict.fromkeys(((value,) for value in range(points)), rounds), "rounds", columns
    )
    assert figure is not None
    return figure


@pytest.mark.parametrize(("columns", "across"), [(1, 2), (2, 3)])
def test_many_learning_curves_fit_a_page_and_the_lowest_panels_have_the_labels(columns: int, across: int) -> None:
    figure = learning(3, 11, columns)
    assert figure.get_figwidth() == plotstyle.WIDTHS_IN[columns]
    assert figure.get_figheight() < 10.0
    shown = figure.axes
    labelled = [place for place, ax in enumerate(shown) if ax.get_xlabel()]
    assert labelled == [*range(11 - across, 11)]
    figure.draw_without_rendering()
    numbered = [place for place, ax in enumerate(shown) if ax.xaxis.get_tick_params()["labelbottom"]]
    assert numbered == labelled
    assert (
        learning(3, 3, columns).axes[0].get_subplotspec().get_gridspec().ncols == columns
    )  # few stand in the columns that are printed


def test_bands_that_lie_on_one_another_stay_pale() -> None:
    for points in (1, 3, 30):
        opacities = [float(band.get_alpha()) for band in learning(points, 1, 1).axes[0].collections]
        assert len(opacities) == points
        assert 1.0 - np.prod(1.0 - np.array(opacities)) <= 0.5 + 1e-9
    assert opacities[0] > 0.0


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
    only = plot_tradeoff(PLACED[1:2], "payload (bits)", "loss", columns, ["method=plan", "method=mfg"])
    caption = only.get_supxlabel().replace("\n", " ")
    assert caption == "not drawn, because a number is unknown: method=plan, method=mfg one flight each: no interval"
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
