"""A mission's table for a terminal: means alone, in 80 columns."""

from rich import box
from rich.table import Table
from rich.text import Text

from meanflock.studies.leaderboard import tables
from meanflock.studies.leaderboard.board import Course
from meanflock.studies.leaderboard.measures import BY_KEY

CAPTION = (
    "Means over n flights; bold: significantly best of all rows. T: travel time; a UAV that never arrived counts with "
    "the duration. Intervals, all columns and what they mean: leaderboard.md and .html"
)


def empty(title: str) -> Table:
    """A table without rows, whose first column has the names of the rows."""
    result = Table(title=title, box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False, show_edge=False)
    result.title_justify = "left"
    result.add_column("row", no_wrap=True)
    return result


def table(course: Course) -> Table:
    """The table of a mission."""
    result = empty(course.title)
    result.caption_justify = "left"
    for heading in ("UAVs", "n") if tables.has_groups(course) else ("n",):
        result.add_column(heading, justify="right", no_wrap=True)
    shown = [key for key in tables.SHORT if any(key in row.cells for row in course.standings)]
    for measure in map(BY_KEY.__getitem__, shown):
        result.add_column(f"{measure.short}\n({measure.unit})", justify="right", no_wrap=True)
    for row in course.standings:
        flown = max((cell.n for cell in row.cells.values()), default=0)
        cells = [
            Text(
                tables.mean(BY_KEY[key], row.cells.get(key)), "bold" if key in row.cells and row.cells[key].best else ""
            )
            for key in shown
        ]
        uavs = [str(row.uavs or course.uavs)] if tables.has_groups(course) else []
        result.add_row(Text(row.name, "red bold" if row.yours else ""), *uavs, str(flown), *cells)
    return result
