"""A leaderboard as Markdown."""

from collections.abc import Mapping, Sequence

from meanflock.studies.leaderboard import tables
from meanflock.studies.leaderboard.board import Board, Course, Standing
from meanflock.studies.leaderboard.measures import MEASURES
from meanflock.studies.markdown import table


def markdown(board: Board, plots: Mapping[str, str], maps: Mapping[str, str], introduction: str = "") -> str:
    """The text of the page.

    Args:
        plots, maps: links by the names of missions. introduction: replaces the first paragraph.
    """
    parts = [
        "# Leaderboard",
        introduction or how_flown(board),
        "## How to read the tables",
        tables.HOW_TO_READ,
        columns(),
    ]
    if len(board.courses) > 1:
        parts += ["## Flights without collisions", tables.OVERVIEW, _table(*_bold(tables.overview(board)))]
    for course in board.courses:
        parts += section(course, board.policies, plots, maps)
    parts += ["## The rows", _table(("row", "controller and settings", "what it is"), tables.settings(rows(board)))]
    return "\n\n".join(parts) + "\n"


def how_flown(board: Board) -> str:
    """Sentence about rows, missions and seeds."""
    first, last = board.seeds[0], board.seeds[-1]
    seeds = f"seeds {first} to {last}" if last > first else f"seed {first}"
    flights = {
        (course.name, row.flight): len(row.values["time_s"]) for course in board.courses for row in course.standings
    }
    flown = f"Flights: {sum(flights.values()):,}, missions: {len(board.courses)}, rows: {len(rows(board))}"
    return f"{flown}, {seeds}, the same for every row. {_codes(board)}"


def _codes(board: Board) -> str:
    """Sentence about the code that flew the rows."""
    (code, _), *others = board.codes().items() or [(board.code, [])]
    exceptions = "".join(f"; code {other}: {', '.join(f'`{name}`' for name in names)}" for other, names in others)
    return f"Code {code}{exceptions}."


def columns() -> str:
    """Descriptions of all columns."""
    return "\n".join(f"- *{measure.titled}*: {measure.about}." for measure in MEASURES)


def section(course: Course, policies: Sequence[str], plots: Mapping[str, str], maps: Mapping[str, str]) -> list[str]:
    """Heading, words, map, table, notes and plots of a mission."""
    conditions = tables.conditions(course, policies)
    parts = [f"## {course.title}", f"`{course.name}`: {course.about or course.title}. {conditions}".rstrip()]
    if course.name in maps:
        parts.append(f"![{tables.MAP.format(course.title)}]({maps[course.name]})")
    if course.standings:
        parts.append(_table(*_bold((tables.head(course), tables.body(course)))))
    if remarks := tables.notes(course):
        parts.append("\n".join(f"- {note}" for note in remarks))
    if course.name in plots:
        parts.append(f"![{tables.PLOTS.format(course.title)}]({plots[course.name]})")
    return parts


def rows(board: Board) -> list[Standing]:
    """All rows, each from the first mission that has it."""
    found: dict[str, Standing] = {}
    for course in board.courses:
        for row in course.standings:
            found.setdefault(row.name, row)
    return list(found.values())


def _bold(shown: tuple[list[str], list[list[tables.Text]]]) -> tuple[list[str], list[list[str]]]:
    head, lines = shown
    return head, [[f"**{cell.text}**" if cell.best else cell.text for cell in line] for line in lines]


def _table(head: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    return "\n".join(table(head, lines))
