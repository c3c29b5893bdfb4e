"""The text of `--run-config`: pairs as Flower takes them."""

import re

import pytest

from meanflock.cli.flower import _pairs
from meanflock.swarm.errors import BadInput


@pytest.mark.parametrize(
    ("text", "pairs"),
    [
        ("", {}),
        ("lr=0.1 rounds=3", {"lr": 0.1, "rounds": 3}),
        ("  name='two words'   on=true ", {"name": "two words", "on": True}),
        ("""options='{"mu": 0.1}' text='a "b" c'""", {"options": '{"mu": 0.1}', "text": 'a "b" c'}),
        ("model.width=32", {"model.width": 32}),
    ],
)
def test_pairs_are_separated_by_spaces_outside_of_quotes(text: str, pairs: dict[str, object]) -> None:
    assert _pairs(text) == pairs


@pytest.mark.parametrize("text", ["lr", "=1", "lr=", "lr=fast", "lr =1"])
def test_a_pair_that_is_none_is_named(text: str) -> None:
    with pytest.raises(BadInput, match=re.escape(f"--run-config {text.split()[0]}: expected key=value")):
        _pairs(text)
