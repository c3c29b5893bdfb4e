"""Tables of pages, and the parts of pages that programs write."""

import pytest

from meanflock.studies.markdown import replaced, table


def test_a_cell_breaks_no_table() -> None:
    assert table(("a", "b"), [("|x|", "two\nlines")]) == ["| a | b |", "|---|---|", "| \\|x\\| | two lines |"]


def test_only_the_text_between_its_two_marks_is_replaced() -> None:
    page = "# A page\n<!-- a -->\nold\n<!-- end -->\n<!-- b -->\nkept\n<!-- end -->\n"
    assert replaced(page, "<!-- a -->", "<!-- end -->", ["new"]) == page.replace("old", "new")
    for wrong in ("# A page\n", "<!-- a -->", "<!-- a --><!-- end --><!-- a --><!-- end -->"):
        with pytest.raises(ValueError, match=r"places for `<!-- a -->`"):
            replaced(wrong, "<!-- a -->", "<!-- end -->", [])
