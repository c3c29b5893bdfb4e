"""Every number in the prose of a page is that of a result, or was looked at as a definition."""

import pytest

from tests.golden import numbers
from tests.sentences import SENTENCES, Sentence, words_of


@pytest.mark.parametrize("sentence", SENTENCES, ids=lambda each: f"{each.page}: {each.words[:50]}")
def test_a_sentence_has_the_numbers_of_the_results(sentence: Sentence) -> None:
    assert sentence.written() in words_of(sentence.page)


@pytest.mark.parametrize("page", numbers.pages())
def test_every_other_number_of_a_page_was_looked_at(page: str) -> None:
    """A new number is that of a result and has a row above, or a definition, and `tests.golden.numbers` writes it."""
    compared = [sentence.written() for sentence in SENTENCES if sentence.page == page]
    assert set(numbers.found(page, compared)) <= set(numbers.read().get(page, []))
