"""Whole numbers of other types than int, as NumPy and other libraries compute them."""

from typing import Any

import msgspec
import numpy as np
import pytest

import meanflock as mf
from meanflock.federation.plan import plan_of
from meanflock.swarm.counts import count_of
from meanflock.testing import check_controller


class Whole:
    """A number as other libraries have them."""

    def __init__(self, number: int) -> None:
        self.number = number

    def __index__(self) -> int:
        return self.number


@pytest.mark.parametrize("value", [3, np.int64(3), np.uint8(3), np.array(3), Whole(3)])
def test_a_count_is_what_operator_index_takes(value: Any) -> None:
    found = count_of("rows:", value, 1, 3)
    assert (found, type(found)) == (3, int)


@pytest.mark.parametrize("value", [3.0, "3", None, True, np.float64(3.0), np.array([3]), np.bool_(True), 0, Whole(4)])
def test_another_value_is_bad_input(value: Any) -> None:
    with pytest.raises(mf.BadInput, match=r"^rows: .*; expected a whole number of 1 … 3$"):
        count_of("rows:", value, 1, 3)


class Sized(mf.Controller):
    """A controller all of whose numbers are of NumPy."""

    name = "sized"
    parameters = np.prod((2, 2))
    parts = (np.int64(3), np.uint8(1))
    weights = np.int32(4)
    period_ticks = np.int64(10)
    broadcast_numbers = Whole(4)  # type: ignore[assignment]

    class Options(mf.Options, frozen=True):
        gain: int = 1

    def init(self, uavs: Any, plan: Any) -> Any:
        return {"model": np.zeros((len(uavs), 4))}

    def step(self, memory: Any, tick: int, own: Any, received: Any) -> mf.Step:
        acceleration = -0.02 * self.options.gain * own[:, :2]
        return mf.Step(memory, acceleration, broadcasts=[mf.Broadcast(own)])

    def get(self, memory: Any) -> Any:
        return memory["model"]

    def set(self, memory: Any, rows: Any, models: Any) -> Any:
        model = memory["model"].copy()
        model[rows] = models
        return memory | {"model": model}


def test_declarations_keys_and_arguments_may_be_of_numpy() -> None:
    two = np.int64(2)
    run = mf.fly(method=Sized, uavs=two, seed=Whole(2), duration=2.0, controller={"gain": np.int8(1)})  # type: ignore[arg-type]
    assert (run.summary["rounds"], run.summary["seed"]) == (1, 2)
    declared = plan_of(run.scenario).declared
    assert (declared.parts, declared.weights, declared.period_ticks, declared.broadcast_numbers) == ((3, 1), 4, 10, 4)
    assert msgspec.json.encode(declared)
    assert len(mf.compare("plan", seeds=two, uavs=two, duration=1.0, jobs=np.uint8(1))) == 1
    assert mf.Stepped(uavs=two, parameters=two, broadcast_numbers=two).models.shape == (2, 2)
    check_controller(Sized, {"gain": two})
