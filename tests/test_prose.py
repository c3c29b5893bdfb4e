"""Every number in the prose of a page is that of a result, or was looked at as a definition."""

import pytest

from tests.golden import numbers
from tests.sentences import SENTENCES, words_of

CASES = [(page, words) for page, sentences in SENTENCES.items() for words in sentences]


@pytest.mark.parametrize(("page", "words"), CASES, ids=lambda each: each[:50])
def test_a_sentence_has_the_numbers_of_the_results(page: str, words: str) -> None:
    assert words.format(*SENTENCES[page][words]()) in words_of(page)


@pytest.mark.parametrize("page", numbers.pages())
def test_every_other_number_of_a_page_was_looked_at(page: str) -> None:
    """A new number is that of a result and has a row there, or a definition, and `tests.golden.numbers` writes it."""
    assert set(numbers.found(page)) <= set(numbers.read().get(page, []))
