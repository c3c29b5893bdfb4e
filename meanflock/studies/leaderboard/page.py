"""The files of a leaderboard: JSON, a Markdown page, and one HTML file that holds its style and pictures."""

import base64
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

from meanflock.studies.leaderboard import maps, markdown, pareto, tables
from meanflock.studies.leaderboard.board import Board, Course
from meanflock.studies.leaderboard.measures import MEASURES
from meanflock.studies.leaderboard.tables import Text
from meanflock.swarm import durable

PICTURES = "pictures"


def html(board: Board, plots: Mapping[str, Path], maps: Mapping[str, Path]) -> str:
    """The text of the file. plots, maps: PNG files by the names of missions."""
    css = Path(__file__).with_name("page.css").read_text(encoding="utf-8")
    links = " · ".join(f"<a href='#{escape(course.name)}'>{escape(course.title)}</a>" for course in board.courses)
    columns = "".join(f"<dt>{escape(measure.titled)}</dt><dd>{escape(measure.about)}</dd>" for measure in MEASURES)
    read = escape(tables.HOW_TO_READ).replace("**Bold**", "<b>Bold</b>")
    settings = [[Text(text) for text in row] for row in tables.settings(markdown.rows(board))]
    rows = _table(("row", "controller and settings", "what it is"), settings, set())
    return (
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>"
        "<meta name='viewport' content='width=device-width, initial-scale=1'>"
        f"<title>Leaderboard</title><style>{css}</style></head><body><main>"
        f"<h1>Leaderboard</h1><p>{escape(markdown.how_flown(board))}</p><nav>{links}</nav>"
        f"<p>{read}</p><details><summary>the columns</summary><dl>{columns}</dl></details>"
        f"{_overview(board)}{''.join(_course(course, board.policies, plots, maps) for course in board.courses)}"
        f"<section><h2>The rows</h2>{rows}</section>"
        "</main></body></html>\n"
    )


def _overview(board: Board) -> str:
    if len(board.courses) < 2:
        return ""
    heading, words = "Flights without collisions", escape(tables.OVERVIEW)
    return f"<section><h2>{heading}</h2><p>{words}</p>{_table(*tables.overview(board), set())}</section>"


def _course(course: Course, policies: Sequence[str], plots: Mapping[str, Path], maps: Mapping[str, Path]) -> str:
    yours = {row.name for row in course.standings if row.yours}
    notes = "".join(f"<li>{escape(note)}</li>" for note in tables.notes(course))
    shown = _table(tables.head(course), tables.body(course), yours) if course.standings else ""
    return (
        f"<section id='{escape(course.name)}'><h2>{escape(course.title)}</h2>"
        f"<p><code>{escape(course.name)}</code>: {escape(course.about or course.title)}. "
        f"{escape(tables.conditions(course, policies)).replace('`', '')}</p>"
        f"<div class='beside'>{shown}{_picture(course, maps, tables.MAP)}</div>"
        f"{f'<ul>{notes}</ul>' if notes else ''}{_picture(course, plots, tables.PLOTS)}</section>"
    )


def _picture(course: Course, pictures: Mapping[str, Path], words: str) -> str:
    """The picture of a mission, inside the page; empty if there is none."""
    if course.name not in pictures:
        return ""
    data = base64.b64encode(pictures[course.name].read_bytes()).decode("ascii")
    return f"<figure><img alt='{escape(words.format(course.title))}' src='data:image/png;base64,{data}'></figure>"


def _table(head: Sequence[str], lines: Sequence[Sequence[Text]], yours: set[str]) -> str:
    top = "".join(f"<th>{escape(each)}</th>" for each in head)
    rows = "".join(
        f"<tr{' class=yours' if line[0].text in yours else ''}>"
        + "".join(f"<td{' class=best' if cell.best else ''}>{escape(cell.text)}</td>" for cell in line)
        + "</tr>"
        for line in lines
    )
    return f"<div class='wide'><table><thead><tr>{top}</tr></thead><tbody>{rows}</tbody></table></div>"


def write(board: Board, out: Path) -> list[Path]:
    """Writes leaderboard.json, leaderboard.md and leaderboard.html into `out`, and the pictures beside them.

    Raises:
        RunFailed: the disk is full.
    """
    paths = [board.write(out), out / "leaderboard.md", out / "leaderboard.html"]
    plots, areas = (draw.write(board.courses, out / PICTURES) for draw in (pareto, maps))
    durable.put(paths[1], markdown.markdown(board, _links(plots), _links(areas)).encode())
    try:
        durable.put(paths[2], html(board, plots, areas).encode())  # it reads the pictures
    except OSError as error:
        raise durable.not_written(out, error) from error
    return paths


def _links(pictures: Mapping[str, Path]) -> dict[str, str]:
    return {name: f"{PICTURES}/{path.name}" for name, path in pictures.items()}
