"""Markdown tables, and replacement of the generated part of a page."""

from collections.abc import Iterable, Mapping, Sequence


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """A table, a line a row."""
    first, *rest = (f"| {' | '.join(map(_cell, row))} |" for row in (head, *rows))
    return [first, f"|{'---|' * len(head)}", *rest]


def replaced(page: str, begin: str, end: str, lines: Iterable[str]) -> str:
    """Replace the part of a page between two marks by lines.

    Raises:
        ValueError: the page has no such part, or several.
    """
    before, *rest = page.split(begin)
    if len(rest) != 1 or end not in rest[0]:
        raise ValueError(f"the page has {len(rest)} places for `{begin}` … `{end}`; it needs one")
    return before + "\n".join([begin, *lines, end]) + rest[0].partition(end)[2]


def with_parts(page: str, parts: Mapping[str, Iterable[str]]) -> str:
    """Replace the parts of a page by lines; a part with a name is between `<!-- NAME -->` and the next `<!-- end -->`.

    Raises:
        ValueError: the page has no such part, or several.
    """
    for name, lines in parts.items():
        page = replaced(page, f"<!-- {name} -->", "<!-- end -->", ["", *lines, ""])
    return page


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")
