"""The suite for vehicles lets ours through, and says of every kind of wrong one what to mend."""

import time

import numpy as np
import pytest

from meanflock.swarm import plugins
from meanflock.testing import ConformanceError, check_vehicle
from meanflock.worldsim.vehicles.base import Hidden, Vehicle


@pytest.mark.parametrize("name", plugins.names("vehicle"))
def test_every_vehicle_of_ours_conforms(name: str) -> None:
    check_vehicle(plugins.load("vehicle", name))


class Good(Vehicle):
    """A point that lags behind its command, from which the wrong ones are made."""

    name = "good"

    def __init__(self, options, scenario):  # type: ignore[no-untyped-def]
        self.dt = scenario.dt

    def init(self, uavs: int) -> Hidden:
        return {"thrust": np.zeros((uavs, 2))}

    def step(self, states, hidden, acceleration, noise):  # type: ignore[no-untyped-def]
        thrust = 0.5 * hidden["thrust"] + 0.5 * acceleration
        velocity = states[:, 2:] + self.dt * thrust + 0.01 * noise
        return np.concatenate([states[:, :2] + self.dt * velocity, velocity], axis=-1), {"thrust": thrust}

    def power(self, states, hidden, acceleration):  # type: ignore[no-untyped-def]
        return 1.0 + hidden["thrust"][:, 0] ** 2


def test_a_good_one_conforms() -> None:
    check_vehicle(Good)


class SeesAnother(Good):
    def step(self, states, hidden, acceleration, noise):  # type: ignore[no-untyped-def]
        after, hidden = super().step(states, hidden, acceleration, noise)
        return after - (1e-3 * after.mean(axis=0) if len(after) else 0.0), hidden


class DrawsItsOwn(Good):
    def step(self, states, hidden, acceleration, noise):  # type: ignore[no-untyped-def]
        return super().step(states, hidden, acceleration, np.random.normal(size=noise.shape))  # noqa: NPY002  # wrong


class KeepsItElsewhere(Good):
    def step(self, states, hidden, acceleration, noise):  # type: ignore[no-untyped-def]
        self.steps = getattr(self, "steps", 0) + 1
        return super().step(states, hidden, acceleration * self.steps, noise)


class WritesToTheStates(Good):
    def step(self, states, hidden, acceleration, noise):  # type: ignore[no-untyped-def]
        states[:, 2:] += self.dt * acceleration
        return super().step(states, hidden, acceleration, noise)


class OfAnotherShape(Good):
    def power(self, states, hidden, acceleration):  # type: ignore[no-untyped-def]
        return np.ones((len(states), 1))


class NotFinite(Good):
    def power(self, states, hidden, acceleration):  # type: ignore[no-untyped-def]
        return np.full(len(states), np.inf)


class Generates(Good):
    def power(self, states, hidden, acceleration):  # type: ignore[no-untyped-def]
        return -np.ones(len(states))


class NeedsAUav(Good):
    def power(self, states, hidden, acceleration):  # type: ignore[no-untyped-def]
        return np.full(len(states), states[0, 0] ** 2)


class ChangesItsForm(Good):
    def step(self, states, hidden, acceleration, noise):  # type: ignore[no-untyped-def]
        after, hidden = super().step(states, hidden, acceleration, noise)
        return after, {"thrust": hidden["thrust"].astype(np.float32)}


class ReturnsTheStates(Good):
    def step(self, states, hidden, acceleration, noise):  # type: ignore[no-untyped-def]
        return states


class Leaves(Good):
    def step(self, states, hidden, acceleration, noise):  # type: ignore[no-untyped-def]
        raise SystemExit(3)


class CannotBegin(Good):
    def init(self, uavs: int) -> Hidden:
        raise OSError("no such table")


class BeginsWithOne(Good):
    def init(self, uavs: int) -> Hidden:
        return {"thrust": np.zeros((1, 2))}


class OfSmallFloats(Good):
    def power(self, states, hidden, acceleration):  # type: ignore[no-untyped-def]
        return np.ones(len(states), dtype=np.float32)


@pytest.mark.parametrize(
    ("wrong", "says", "mend"),
    [
        (SeesAnother, "beside others than alone", "from that row alone"),
        (DrawsItsOwn, "otherwise a second time", "all noise is in the argument"),
        (KeepsItElsewhere, "from a checkpoint differs", "keep all you remember in `hidden`"),
        (WritesToTheStates, "writes to an array", "copy before you write"),
        (OfAnotherShape, r"power \(5, 1\) of 5 UAVs", "return states"),
        (NotFinite, "not finite", "guard divisions"),
        (Generates, "below zero", "in watts"),
        (NeedsAUav, "`power` failed: IndexError", "any number of UAVs must do"),
        (ReturnsTheStates, "`step` returns a ndarray", "return the states and the hidden state"),
        (Leaves, r"`step` failed: SystemExit: 3 \(test_vehicles.py, line \d+\)", "any number of UAVs must do"),
        (CannotBegin, "`init` failed: OSError: no such table", "return a dict of arrays"),
        (BeginsWithOne, r"hidden\['thrust'\] has shape \(1, 2\); expected a leading axis of 5", "a checkpoint"),
        (OfSmallFloats, "power is float32", "return float64"),
        (ChangesItsForm, r"hidden.* of `init` it ", "keep dtypes and shapes"),
    ],
)
def test_a_wrong_one_is_told_what_to_mend(wrong: type[Vehicle], says: str, mend: str) -> None:
    with pytest.raises(ConformanceError, match=rf"^{wrong.__name__}: .*{says}.*; .*{mend}"):
        check_vehicle(wrong)


class Slow(Good):
    def step(self, states, hidden, acceleration, noise):  # type: ignore[no-untyped-def]
        time.sleep(0.004)
        return super().step(states, hidden, acceleration, noise)


def test_a_slow_one_is_told_how_slow() -> None:
    with pytest.raises(
        ConformanceError, match=r"^Slow: a tick of 5 UAVs takes \d+ ms; make it quicker, or pass a larger `slow_ms`"
    ):
        check_vehicle(Slow, slow_ms=3.0)
