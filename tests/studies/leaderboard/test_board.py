"""The pages, fields, file and pictures of a leaderboard."""

import itertools
import json
import re
from html import unescape
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

from meanflock.results.statistics import Estimate
from meanflock.studies.leaderboard import board, maps, markdown, missions, pareto, rows
from meanflock.studies.leaderboard.contest import Contest
from meanflock.studies.leaderboard.measures import BY_KEY
from meanflock.studies.store import Store
from meanflock.swarm.errors import EXIT_DONE
from meanflock.swarm.scenario import load
from tests.pages import script_of
from tests.studies.conftest import BOARD


def test_the_pages_show_the_same_cells_and_the_data_page_every_field(run, tmp_path, small) -> None:
    assert run("leaderboard", "--missions", *small, "--controllers", "cruise", "mfg", *BOARD)[0] == EXIT_DONE
    text = (tmp_path / "out/leaderboard.md").read_text()
    page = (tmp_path / "out/leaderboard.html").read_text()
    fetched = re.findall(r"""<(?!a\b)[^>]*\b(?:src|href)=["']?([^"'>\s]*)""", page)
    assert [address.partition(",")[0] for address in fetched] == ["data:image/png;base64"] * 2 * len(small)
    table = [re.findall(r"<t[dh]\b[^>]*>(.*?)</t[dh]>", line, re.DOTALL) for line in page.split("<tr")]
    shown = [[unescape(re.sub(r"<[^>]*>", "", cell)) for cell in line] for line in table]
    lines = [line for line in text.splitlines() if line.startswith("| ")]
    cells = [[cell.strip().strip("*") for cell in line.strip("|").split(" | ")] for line in lines]
    assert [line for line in cells if line[0] in ("cruise", "mfg")] == [
        line for line in shown if line[:1] in (["cruise"], ["mfg"])
    ]
    for picture in re.findall(r"\]\((pictures/\S+)\)", text):
        assert (tmp_path / "out" / picture).read_bytes().startswith(b"\x89PNG")
    known = {field.key for field in board.FIELDS}
    found = keys(json.loads((tmp_path / "out/leaderboard.json").read_bytes()), "")
    assert {key for key in found if not key.endswith(("absent", "settings"))} <= known
    assert found >= {key for key in known if not key.endswith(("absent.*", "settings.*"))}


def keys(value: Any, path: str) -> set[str]:
    if isinstance(value, dict) and value:
        free = path.split(".")[-1] in ("absent", "settings", "cells", "kbit_by_kind", "values")
        return set().union(*(keys(one, f"{path}.{'*' if free else key}") for key, one in value.items()))
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return set().union(*(keys(one, path) for one in value))
    return {path.removeprefix(".")}


def row(name: str, energy: float, settings: dict[str, str] | None = None, **means: float) -> board.Standing:
    """A row of thirty flights that are free and in which all arrive, unless `means` differ."""
    rng = np.random.default_rng(len(name))
    columns = {key: np.full(30, np.nan) for key in BY_KEY}
    numbers = {"arrived": 1.0, "free": 1.0} | means
    columns |= {key: np.full(30, number) for key, number in numbers.items()}
    columns["free"][0] = float(numbers["free"] == 1.0)
    columns["energy_J"] = energy + 0.1 * rng.normal(size=30)
    values = {key: [board.rounded(value) for value in numbers] for key, numbers in columns.items()}
    return board.Standing(name, name, "", settings or {}, False, board.cells(columns), {}, values)


def test_only_safe_rows_are_compared_by_energy_and_only_rows_of_one_filter_by_infeasible_ticks() -> None:
    for worse in ({"arrived": 0.9}, {"free": 0.99}):
        rows = [row("unsafe", 1.0, **worse), row("good", 5.0), row("costly", 9.0)]
        assert [result.cells["energy_J"].best for result in board.marked(rows)] == [False, True, False]
    behind = {"filter.kind": "ecbf"}
    rows = [row("a", 5.0, behind, infeasible=3.0), row("bb", 5.0, behind, infeasible=9.0)]
    rows.append(row("orca", 5.0, infeasible=1.0))
    assert [result.cells["infeasible"].best for result in board.marked(rows)] == [True, False, False]


def flown(code: str, *standings: board.Standing, **parts: Any) -> board.Board:
    absent = {"straight": "flies windmap only"} if code == "1+a" else {"lqr": "no more"}
    course = board.Course("near", "Near", "", 3, 4.0, board.marked(list(standings)), absent, [], [])
    return board.Board(**{"schema": 1, "version": "1", "code": code, "seeds": [1, 2], "courses": [course]} | parts)


def test_joined_boards_have_the_later_rows_and_name_the_code_of_each() -> None:
    first = flown("1+a", row("mine", 2.0), row("orca", 6.0), row("lqr", 9.0), row("plan", 5.0))
    second = flown("1+b", row("orca", 4.0), row("straight", 7.0))
    both = board.joined([first, second])
    (course,) = both.courses
    names = {each.name: each for each in course.standings}
    assert list(names) == ["plan", "orca", "straight", "mine"]  # of rows.toml, then others
    assert names["orca"].cells["energy_J"].mean == pytest.approx(4.0, abs=0.1)
    assert course.absent == {"lqr": "no more"}
    assert both.codes() == {"1+a": ["plan", "mine"], "1+b": ["orca", "straight"]}
    assert "Code 1+a; code 1+b: `orca`, `straight`." in markdown.how_flown(both)
    assert names["mine"].cells["energy_J"].best  # marked anew
    assert board.joined([both]) == both
    far = msgspec.structs.replace(second.courses[0], name="far")
    longer = msgspec.structs.replace(course, duration_s=9.0)
    more = board.joined([first, flown("1+b", courses=[far])])
    assert [each.name for each in more.courses] == ["near", "far"]
    assert [each.name for each in more.courses[0].standings] == ["lqr", "plan", "orca", "mine"]
    assert more.codes() == {"1+a": ["near"], "1+b": ["far"]}
    for part in ({"seeds": [1]}, {"policies": ["tick"]}, {"courses": [longer]}):
        with pytest.raises(board.BadInput, match="cannot be joined"):
            board.joined([first, flown("1+b", row("orca", 4.0), **part)])


def test_a_board_that_was_written_is_read_as_the_same_and_a_damaged_one_is_bad_input(tmp_path, small) -> None:
    contest = Contest([missions.BoardMission(str(tmp_path / small[0]))], rows.chosen(["cruise"]), 1, 1)
    result = contest.fly(1, lambda *_: None, Store(tmp_path / "out"))
    path = result.write(tmp_path)
    assert msgspec.json.encode(board.read(path)) == msgspec.json.encode(result)
    json.loads(path.read_text())  # as any other reader does
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(board.BadInput, match=r"leaderboard\.json: no leaderboard"):
        board.read(path)


def test_the_published_page_is_that_of_its_results_and_its_verdicts_follow_from_intervals() -> None:
    script = script_of("leaderboard")
    found = board.read(script.RESULTS)
    assert script.PAGE.read_text(encoding="utf-8") == script.page(found), "run `python docs/leaderboard.py`"
    controllers = script.CONTROLLERS.read_text(encoding="utf-8")
    assert controllers == script.controllers(found, controllers), "run `python docs/leaderboard.py`"
    ends = {
        (0.02, 0.03): "confirmed",
        (-0.03, -0.02): "refuted",
        (-0.02, 0.02): "undecided",
        (0.1, np.inf): "undecided",
    }
    assert {pair: script._verdict(Estimate(0.0, *pair, 9)) for pair in ends} == ends
    gains = {(0.02, 0.03): "refuted", (-0.03, 0.005): "confirmed", (-0.02, 0.02): "undecided"}
    assert {pair: script._no_gain([Estimate(0.0, *pair, 9)]) for pair in gains} == gains


COURSES = {course.name: course for course in board.read(script_of("leaderboard").RESULTS).courses}


def boxes(figure: Figure, texts: list[Any]) -> list[Bbox]:
    renderer = figure.canvas.get_renderer()  # type: ignore[attr-defined]
    return [text.get_window_extent(renderer) for text in texts]


@pytest.mark.parametrize("name", ["paper", "obstacles", "windmap"])
def test_every_row_has_its_number_once_and_no_number_hides_another(name: str) -> None:
    course = COURSES[name]
    figure = pareto.draw(course)
    assert figure.get_supxlabel().startswith("mean and 95 % interval over ")
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
    assert rows.family("mfgfl-h", "orca") == "classics"  # of a group
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
