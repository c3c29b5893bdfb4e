"""The pictures of a leaderboard: numbers that can be read, axes with numbers, and maps of the missions."""

import itertools
from pathlib import Path
from typing import Any

import pytest
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

from meanflock.studies.leaderboard import board, maps, missions, pareto, rows
from meanflock.swarm.scenario import load
from tests.pages import script_of

COURSES = {course.name: course for course in board.read(script_of("leaderboard").RESULTS).courses}


def boxes(figure: Figure, texts: list[Any]) -> list[Bbox]:
    renderer = figure.canvas.get_renderer()  # type: ignore[attr-defined]
    return [text.get_window_extent(renderer) for text in texts]


@pytest.mark.parametrize("name", ["paper", "obstacles", "windmap"])
def test_every_row_has_its_number_once_and_no_number_hides_another(name: str) -> None:
    course = COURSES[name]
    figure = pareto.draw(course)
    numbers = {str(number): row.name for number, row in enumerate(course.standings, 1) if pareto.drawn(row)}
    *plots, names = figure.axes
    for ax in plots:
        assert sorted(text.get_text() for text in ax.texts) == sorted(numbers)
        places = boxes(figure, ax.texts)
        assert not any(one.overlaps(other) for one, other in itertools.combinations(places, 2))
        frame = ax.get_window_extent()
        assert all(frame.x0 <= place.x0 and place.x1 <= frame.x1 for place in places)
        for axis in (ax.xaxis, ax.yaxis):
            low, high = axis.get_view_interval()
            marks = [*axis.get_major_ticks(), *axis.get_minor_ticks()]
            assert sum(bool(mark.label1.get_text()) and low <= mark.get_loc() <= high for mark in marks) >= 2
    words = [text.get_text() for text in names.texts]
    assert {number: words[words.index(number) + 1] for number in numbers} == numbers
    places = boxes(figure, names.texts)
    assert not any(one.overlaps(other) for one, other in itertools.combinations(places, 2))
    assert max(place.x1 for place in places) <= figure.bbox.x1
    assert min(place.y0 for place in places) >= 0.0


def test_every_shipped_row_has_a_family_with_a_look_and_others_have_that_of_their_controller() -> None:
    assert {row.family for row in rows.shipped()} <= set(pareto.LOOKS) - {pareto.OTHERS, pareto.YOURS}
    assert rows.family("orca-of-old", "orca") == "classics"
    assert rows.family("mine", "mine") == ""


def test_a_map_has_the_ways_the_obstacles_and_the_wind_of_its_mission() -> None:
    for mission in missions.shipped():
        flown = load(Path(mission.name))
        (ax,) = maps.draw(flown).axes
        ways = next(each for each in ax.collections if isinstance(each, LineCollection))
        assert len(ways.get_segments()) == flown.uavs
        discs = next(each for each in ax.collections if isinstance(each, EllipseCollection))
        assert len(discs.get_offsets()) == len(flown.obstacles) or not flown.obstacles
        said = [text.get_text() for text in ax.get_figure(root=True).legends[0].get_texts()]  # type: ignore[union-attr]
        assert ("obstacle" in said, "gusts" in said) == (bool(flown.obstacles), bool(flown.faults))
        assert ("wind of one seed" in said) == bool(flown.wind.field_rms)
