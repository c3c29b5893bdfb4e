"""The suite for filters rejects each kind of mistake with its name."""

from typing import Any

import numpy as np
import pytest

from meanflock.agent.controllers.filtered import Filter
from meanflock.testing import ConformanceError, check_filter
from tests.testing.good import GoodFilter, changed


def sees_another_row(_self: Any, answer: Any, own: Any, *_: Any) -> Any:
    return answer[0] + own[:, :2].sum(axis=0), answer[1]


def writes_to_the_commands(_self: Any, answer: Any, _own: Any, _others: Any, _uavs: Any, wanted: Any) -> Any:
    wanted += 1.0
    return answer


WRONG: dict[str, tuple[Any, str]] = {
    "sees another row": (
        changed(GoodFilter, "admit", sees_another_row),
        "beside others in one process than alone, .*; compute every row",
    ),
    "writes to the commands": (
        changed(GoodFilter, "admit", writes_to_the_commands),
        "`admit` writes to an array .*; .*copy before you write",
    ),
    "reports nothing": (
        changed(GoodFilter, "admit", lambda _self, answer, *_: (answer[0], answer[1][:, :0])),
        r"returns shapes \(\(6, 2\), \(6, 0\)\), expected \(\(6, 2\), \(6, 1\)\); .*`columns` wide",
    ),
    "returns what is not finite": (
        changed(GoodFilter, "admit", lambda _self, answer, *_: (answer[0] * np.nan, answer[1])),
        "not finite; guard divisions",
    ),
    "makes up a command": (
        changed(GoodFilter, "admit", lambda _self, answer, *_: (np.nan_to_num(answer[0]), answer[1])),
        "makes a number of a command that is none; let it pass",
    ),
    "columns are a text": (
        type("Wrong", (GoodFilter,), {"columns": "apart"}),
        r"cannot be made: TypeError: `columns` is a text; write \('apart',\)",
    ),
}


@pytest.mark.parametrize(("wrong", "expected"), WRONG.values(), ids=WRONG)
def test_a_wrong_filter_is_rejected_with_its_mistake(wrong: type[Filter], expected: str) -> None:
    with pytest.raises(ConformanceError, match=f"^Wrong: .*{expected}"):
        check_filter(wrong)
