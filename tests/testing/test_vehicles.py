"""The suite for vehicles rejects each kind of mistake with its name."""

from typing import Any

import numpy as np
import pytest

from meanflock.testing import ConformanceError, check_vehicle
from meanflock.worldsim.vehicles.base import Vehicle
from tests.testing.good import GoodVehicle, changed, failing


def sees_another_row(_self: Any, answer: Any, *_: Any) -> Any:
    return answer[0] - 1e-3 * answer[0].sum(axis=0), answer[1]


def writes_to_the_states(_self: Any, answer: Any, states: Any, *_: Any) -> Any:
    states[:, 2:] += 1.0
    return answer


def powered(power: Any) -> Any:
    """A vehicle whose power is `power(states)`."""
    return type("Wrong", (GoodVehicle,), {"power": lambda _self, states, *_: power(states)})


WRONG: dict[str, tuple[Any, str]] = {
    "sees another row": (
        changed(GoodVehicle, "step", sees_another_row),
        "beside others than alone; .*from that row alone",
    ),
    "writes to the states": (
        changed(GoodVehicle, "step", writes_to_the_states),
        "writes to an array .*; .*copy before you write",
    ),
    "hidden state of another type": (
        changed(
            GoodVehicle, "step", lambda _self, answer, *_: (answer[0], {"thrust": np.float32(answer[1]["thrust"])})
        ),
        r"hidden.* of `init` it .*; .*keep dtypes and shapes",
    ),
    "hidden state of one row": (
        type("Wrong", (GoodVehicle,), {"init": lambda *_: {"thrust": np.zeros((1, 2))}}),
        r"hidden\['thrust'\] has shape \(1, 2\); expected a leading axis of 5 .*; .*a checkpoint",
    ),
    "fails at first": (
        failing(GoodVehicle, "init", OSError("no such table")),
        "`init` failed: OSError: no such table .*; return a dict of arrays",
    ),
    "a column of power": (
        powered(lambda states: np.ones((len(states), 1))),
        r"power \(5, 1\) of 5 UAVs; return states",
    ),
    "power of 32 bits": (powered(lambda states: np.ones(len(states), "f4")), "power is float32; return float64"),
    "infinite power": (powered(lambda states: np.full(len(states), np.inf)), "not finite; guard divisions"),
    "power below zero": (powered(lambda states: -np.ones(len(states))), "below zero; .*in watts"),
    "needs a UAV": (
        powered(lambda states: np.full(len(states), states[0, 0] ** 2)),
        "failed: IndexError.*; any number of UAVs must do",
    ),
}


@pytest.mark.parametrize(("wrong", "expected"), WRONG.values(), ids=WRONG)
def test_a_wrong_vehicle_is_rejected_with_its_mistake(wrong: type[Vehicle], expected: str) -> None:
    with pytest.raises(ConformanceError, match=f"^Wrong: .*{expected}"):
        check_vehicle(wrong)
