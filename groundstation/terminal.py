"""Tables in a terminal: whole numbers, however narrow it is."""

from rich.console import Console
from rich.table import Table

_ANY = 1000  # columns: more than any table of ours takes


def console_for(table: Table) -> Console:
    """Standard output, at least as wide as the table: a terminal that is narrower wraps lines, and cuts no number."""
    console = Console()
    wanted = Console(width=_ANY).measure(table).maximum
    return console if console.width >= wanted else Console(width=wanted)
