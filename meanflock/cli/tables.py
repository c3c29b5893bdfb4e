"""Tables in a terminal, of at least 80 columns: no number is cut off, and no table is wider."""

import re
from collections.abc import Sequence
from copy import copy
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Column, Table

WIDTH = 80  # of a terminal, at least
_LOOSE = (0, 1, 0, 0)  # space around a cell
_GAP = 2  # columns between two cells, with that space
_WIDE = 1000  # columns: wider than any table
_NARROWEST = 12  # columns of a text that folds
_NAME = 16  # characters of a line of a name that is joined by `+`
_JOINT = re.compile(r"(?<=[._/+-])(?=[^\W\d_])")  # within a word: before a letter, after a mark


def empty(title: str | None = None, caption: str | None = None) -> Table:
    """A table without columns."""
    table = Table(title=title, caption=caption, box=box.SIMPLE_HEAD, padding=_LOOSE, pad_edge=False, show_edge=False)
    table.title_justify = table.caption_justify = "left"
    return table


def print_table(table: Table) -> None:
    """Print a table that is no wider than the terminal, or than 80 columns in a narrower one.

    A table that does not fit is set tightly: less space between columns, and headings in more lines. If it does not fit
    then, long names go on in another line after a `+`. At last its columns are divided into tables below each other,
    each with the columns of text that come first.
    """
    width = max(WIDTH, Console().width)
    console = Console(width=width)
    if table.title:
        console.print(table.title, style="table.title", markup=False, highlight=False)
    forms = [{}, {"is_tight": True}, {"is_tight": True, "has_folded_names": True}]
    whole = (_columns_of(table, table.columns, **form) for form in forms)
    parts = next(([one] for one in whole if _least(one) <= width), None) or _parts(table, width)
    for number, part in enumerate(parts):
        if number:
            console.print()
        room = max(width, _least(part))
        Console(width=room).print(_fit(part, room))
    if table.caption:
        console.print(table.caption, style="table.caption", markup=False, highlight=False)


def _parts(table: Table, width: int) -> list[Table]:
    """The table in the fewest parts that fit, about as wide as each other, with folded names."""
    widths = [_least(_columns_of(table, [column], has_folded_names=True)) for column in table.columns]
    numbers = next((place for place, column in enumerate(table.columns) if column.justify == "right"), 0)
    first, others = [*range(max(1, numbers))], [*range(max(1, numbers), len(widths))]

    def divided(most: int) -> list[list[int]]:
        """Places of the columns of each part, of at most that width."""
        parts: list[list[int]] = []
        for place in others:
            if not parts or sum(widths[each] + _GAP for each in (*parts[-1], place)) - _GAP > most:
                parts.append([*first])
            parts[-1].append(place)
        return parts

    fewest = divided(width)
    narrow = next(most for most in range(width + 1) if len(divided(most)) == len(fewest))
    parts = [[table.columns[place] for place in part] for part in divided(narrow)]
    return [_columns_of(table, part, has_folded_names=True) for part in parts]


def _columns_of(
    table: Table, columns: Sequence[Column], *, is_tight: bool = False, has_folded_names: bool = False
) -> Table:
    """Some columns of a table as a table without title and caption.

    Args:
        has_folded_names: whether names, which are texts that do not wrap, stand in lines that end with `+`.
    """
    found = _without_columns(table)
    texts: list[list[Any]] = []
    for column in columns:
        heading = re.sub(r"(?<=\w\w)_(?=\w\w)", "_\n", str(column.header)) if is_tight else column.header
        _add_column(found, column, heading)
        is_folded = has_folded_names and column.no_wrap and column.justify == "left"
        texts.append([_folded(str(cell)) if is_folded else cell for cell in column.cells])
    for cells in zip(*texts, strict=True):
        found.add_row(*cells)
    if is_tight:
        found.padding = 0
    return found


def _without_columns(table: Table) -> Table:
    """The same kind of table without title, caption, columns and rows."""
    found = copy(table)
    found.title = found.caption = None
    found.columns, found.rows = [], []
    return found


def _add_column(table: Table, column: Column, heading: Any, width: int | None = None) -> None:
    """Add a column without cells; `width`: None: that of its cells."""
    table.add_column(
        heading,
        style=column.style,
        justify=column.justify,
        overflow=column.overflow,
        no_wrap=column.no_wrap,
        width=width,
    )


def _folded(name: str) -> str:
    """A name whose lines end with `+`, of at most 16 characters where that is possible."""
    return _filled(re.findall(r"[^+]*\+|[^+]+", name), _NAME)


def _filled(parts: Sequence[str], width: int) -> str:
    """Parts of a word, in lines of at most that width where that is possible."""
    lines = [""]
    for part in parts:
        if lines[-1] and len(lines[-1] + part) > width:
            lines.append("")
        lines[-1] += part
    return "\n".join(lines)


def _least(table: Table) -> int:
    """Width of a table whose columns of text are as narrow as their longest word, or narrower if that may fold."""
    return Console(width=_WIDE).measure(table).maximum - sum(most - least for least, most in map(_range, table.columns))


def _range(column: Column) -> tuple[int, int]:
    """The least and the most width that a column needs; its heading never folds within a word."""
    wide = Console(width=_WIDE)
    heading, *cells = (wide.measure(cell) for cell in (column.header, *column.cells))
    most = max(cell.maximum for cell in (heading, *cells))
    if column.no_wrap:
        return most, most
    word = max((cell.minimum for cell in cells), default=0)
    if column.overflow == "fold" and column.justify == "left":
        word = min(word, _NARROWEST)
    return max(heading.minimum, word), most


def _fit(table: Table, width: int) -> Table:
    """The table, whose widest columns are narrowed until it fits; none below its least width."""
    ranges = [_range(column) for column in table.columns]
    widths = [most for _, most in ranges]
    for _ in range(Console(width=_WIDE).measure(table).maximum - width):
        place = max(range(len(widths)), key=lambda at: (widths[at] > ranges[at][0], widths[at]))
        widths[place] -= 1
    found = _without_columns(table)
    texts: list[list[Any]] = []
    for column, width in zip(table.columns, widths, strict=True):
        _add_column(found, column, column.header, width)
        texts.append([_in_lines(str(cell), width) if column.overflow == "fold" else cell for cell in column.cells])
    for cells in zip(*texts, strict=True):
        found.add_row(*cells)
    return found


def _in_lines(text: str, width: int) -> str:
    """A text in which words that are wider than a column go on in another line after a `.`, `_`, `/`, `+` or `-`."""
    return re.sub(rf"\S{{{width + 1},}}", lambda word: _filled(_JOINT.split(word[0]), width), text)
