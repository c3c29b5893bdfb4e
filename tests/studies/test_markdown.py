"""Tables of pages, and the parts of pages that programs write."""

import pytest

from meanflock.studies.markdown import replaced, table


def test_a_cell_breaks_no_table() -> None:
    assert table(("a", "b"), [("|x|", "two\nlines")]) == ["| a | b |", "|---|---|", "| \\|x\\| | two lines |"]


def test_what_stands_between_two_marks_is_replaced_and_nothing_else() -> None:
    page = "# A page\n<!-- a -->\nold\n<!-- end -->\n<!-- b -->\nkept\n<!-- end -->\n"
    again = replaced(page, "<!-- a -->", "<!-- end -->", ["", "new", ""])
    assert again == page.replace("\nold\n", "\n\nnew\n\n")
    assert replaced(again, "<!-- a -->", "<!-- end -->", ["old"]) == page


@pytest.mark.parametrize("page", ["# A page\n", "<!-- fit -->", "<!-- fit --><!-- end --><!-- fit --><!-- end -->"])
def test_a_page_without_the_place_or_with_two_is_left_alone(page: str) -> None:
    with pytest.raises(ValueError, match=r"places for `<!-- fit -->`"):
        replaced(page, "<!-- fit -->", "<!-- end -->", [])
