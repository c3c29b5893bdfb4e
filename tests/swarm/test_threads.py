"""Plug-ins run with one thread of the numeric libraries, and the user's numbers come back."""

import sys
import threading
from collections.abc import Iterator
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import meanflock as mf
from meanflock.swarm import threads
from meanflock.worldsim.vehicles.point_mass import PointMass

THREE = 3


class Torch(ModuleType):
    """A library with a number of threads, as torch has it."""

    number = THREE

    def get_num_threads(self) -> int:
        return self.number

    def set_num_threads(self, number: int) -> None:
        self.number = number


def blas() -> set[int]:
    """Numbers of threads of the BLAS libraries that are loaded."""
    found = {pool.get() for pool in threads._pools() if not pool.of_thread}
    assert found, "NumPy has no BLAS"
    return found


@pytest.fixture
def torch(monkeypatch: pytest.MonkeyPatch) -> Iterator[Torch]:
    """A torch with three threads, and BLAS with three threads."""
    fake = Torch("torch")
    monkeypatch.setitem(sys.modules, "torch", fake)
    before = [(pool, pool.get()) for pool in threads._pools() if pool.name != "torch"]
    for pool, _ in before:
        pool.set(THREE)
    yield fake
    for pool, number in before:
        pool.set(number)
    monkeypatch.undo()
    threads._modules = -1  # without the fake


def test_a_limit_ends_with_the_number_of_the_one_around_it(torch: Torch) -> None:
    found = []
    with threads.limited():
        found.append((torch.number, blas()))
        with threads.limited(2):
            found.append((torch.number, blas()))
        found.append((torch.number, blas()))
    assert [*found, (torch.number, blas())] == [(1, {1}), (2, {2}), (1, {1}), (3, {3})]


def test_a_flight_that_ends_leaves_the_limit_of_another_thread(torch: Torch) -> None:
    entered, over = threading.Event(), threading.Event()
    found = []

    def other() -> None:
        with threads.limited():
            entered.set()
            assert over.wait(60.0)
            found.append(blas())

    flying = threading.Thread(target=other)
    with threads.limited():
        flying.start()
        assert entered.wait(60.0)
    over.set()
    flying.join()
    assert (found, blas()) == ([{1}], {THREE})


def test_a_library_that_is_loaded_in_flight_is_limited_at_the_next_tick(
    torch: Torch, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delitem(sys.modules, "torch")
    with threads.limited():
        monkeypatch.setitem(sys.modules, "torch", torch)
        threads.renew_if_loaded()
        assert torch.number == 1
    assert torch.number == THREE


def test_a_process_of_a_swarm_limits_what_a_plugin_has_set(torch: Torch) -> None:
    threads.renew()
    assert torch.number == 1


class Counting(mf.Controller):
    """Keeps the numbers of threads in which it began and flew, and sets another one when it is made."""

    name = "counting"
    found: set[tuple[int, int]]

    def __init__(self, options: Any, scenario: Any) -> None:
        super().__init__(options, scenario)
        sys.modules["torch"].set_num_threads(2)

    def step(self, memory: Any, tick: int, own: Any, received: Any) -> mf.Step:
        type(self).found.add((sys.modules["torch"].get_num_threads(), max(blas())))
        return mf.Step(memory, -0.02 * own[:, :2])


class Carried(PointMass):
    """A vehicle that keeps the numbers of threads of each tick."""

    name = "carried"
    found: set[int]

    def step(self, *given: Any) -> Any:
        type(self).found.add(sys.modules["torch"].get_num_threads())
        return super().step(*given)

    def power(self, *given: Any) -> Any:
        type(self).found.add(sys.modules["torch"].get_num_threads())
        return super().power(*given)


def test_a_flight_has_one_thread_and_the_caller_gets_his_back(torch: Torch) -> None:
    Counting.found = set()
    mf.fly(method=Counting, uavs=2, duration=1.0)
    assert (Counting.found, torch.number, blas()) == ({(1, 1)}, THREE, {THREE})
    mf.compare(Counting, seeds=1, uavs=2, duration=1.0)
    assert Counting.found == {(1, 1)}


def test_steps_have_one_thread_and_the_program_between_them_its_own(torch: Torch) -> None:
    Carried.found = set()
    mf.register(Carried)
    flight = mf.Stepped(uavs=2, duration=1.0, **{"vehicle.model": "carried"})
    while not flight.over:
        assert torch.number == THREE
        flight.step(np.zeros((2, 2)))
    flight.finish()
    assert (Carried.found, torch.number) == ({1}, THREE)


def test_an_exception_ends_the_limit(torch: Torch) -> None:
    def stop(*_: Any) -> None:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        mf.fly("paper", method="plan", uavs=2, duration=15.0, progress=stop)
    assert (torch.number, blas()) == (THREE, {THREE})
