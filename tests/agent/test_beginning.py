"""A controller that cannot begin is refused before take-off, in one line."""

from typing import Any

import numpy as np
import pytest

from meanflock.agent.controllers.base import Controller, Memory
from meanflock.groundstation.launch.engine import Engine
from meanflock.swarm.errors import BadInput
from tests.agent.strangers import Honest, flown, wrong


def explodes(*_: Any) -> Any:
    raise OSError("no such table")


def fails_with_two(self: Honest, uavs: np.ndarray, plan: np.ndarray) -> Memory:
    if (uavs % 2).any():
        raise ValueError("an odd one")
    return Honest.init(self, uavs, plan)


BEGINS_WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "raises when it is made": ({"__init__": explodes}, r"be made: OSError: no such table \(test_beginning.py, line"),
    "raises in init": ({"init": explodes}, r"failed in `init` with UAV 0: OSError: no such table"),
    "raises in the init of two": (
        {"init": fails_with_two},
        r"`init` with UAV 1, 3: ValueError: .* \(test_beginning.py",
    ),
    "names an array by a number": (
        {"init": lambda self, *given: Honest.init(self, *given) | {1: given[0]}},
        r"memory\[1\]: its name must be a text",
    ),
    "remembers no dict": ({"init": lambda *_: [1, 2]}, r"memory is a list; expected a dict of arrays"),
    "remembers other rows": ({"init": lambda *_: {"model": np.zeros((3, 2))}}, r"a leading axis of 5 rows"),
    "remembers complex numbers": ({"init": lambda *_: {"model": np.zeros((5, 2), "c16")}}, r"keeps arrays of bool,"),
    "remembers large integers": ({"init": lambda *_: {"n": np.zeros(5, np.uint64)}}, r"memory\['n'\] is uint64 "),
    "declares a truth": ({"parameters": True}, r"`parameters` is True"),
    "declares too much": ({"parameters": 10**9}, r"`parameters` is 1000000000; expected 0 … 1000000"),
    "declares parts that do not add up": ({"parts": (1, 2)}, r"`parts` \(1, 2\) do not add up to its 2"),
    "declares no parts": ({"parts": 3}, r"a declaration cannot be read"),
    "declares weights without end": ({"weights": 10**9}, r"`weights`"),
    "declares no period": ({"period_ticks": 0}, r"`period_ticks` is 0"),
    "declares a text of diagnostics": ({"diagnostics": "speed"}, r"is a text; write \('speed',\)"),
    "declares a diagnostic twice": ({"diagnostics": ("a", "a")}, r"different names"),
    "declares a diagnostic with a space": ({"diagnostics": ("a b",)}, r"different names"),
    "has a model of another size": (
        {"get": lambda _, memory: memory["model"][:, :1]},
        r"`get` returns shape \(1, 1\); expected \(1, 2\)",
    ),
    "has no model": ({"get": Controller.get}, r"declares `parameters` must override `get`"),
    "takes no model": ({"set": Controller.set}, r"declares `parameters` must override `set`"),
    "fails to declare": ({"parameters": property(explodes)}, r"a declaration cannot be read: OSError"),
}


@pytest.mark.parametrize("what", BEGINS_WRONG)
def test_a_controller_that_cannot_begin_is_bad_input_of_one_line(what: str) -> None:
    attributes, text = BEGINS_WRONG[what]
    with pytest.raises(BadInput, match=text) as caught:
        Engine(flown(wrong(**attributes)), "strangers")
    assert "'stranger'" in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
