"""Tables in a terminal: whole numbers, however narrow it is; what may go over several lines does so first."""

from rich.console import Console
from rich.table import Table

_ANY = 1000  # columns: more than any table of ours takes


def console_for(table: Table) -> Console:
    """Standard output, at least as wide as the table must be: a narrower terminal wraps lines, and cuts no number."""
    console, any_ = Console(), Console(width=_ANY)
    wanted = any_.measure(table).maximum
    for column in table.columns:
        if not column.no_wrap:
            cells = [any_.measure(cell) for cell in (column.header, *column.cells)]
            wanted -= max(cell.maximum for cell in cells) - max(cell.minimum for cell in cells)
    return console if console.width >= wanted else Console(width=wanted)
