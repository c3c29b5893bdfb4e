"""What the agents say stands in the rows of their UAVs, whoever answers, and nothing beyond all bounds does."""

import numpy as np
import pytest

from meanflock.swarm.model import BEYOND_SENSE
from meanflock.worldsim.commands import Commands
from meanflock.worldsim.members import Member

UAVS = 5
EVERYONE = {
    "agent-0": Member("agent-0", "agent", np.array([0])),
    "agent-1": Member("agent-1", "agent", np.array([1, 2, 3])),
    "leader-0": Member("leader-0", "leader", np.zeros(0, dtype=np.intp)),
    "agent-4": Member("agent-4", "agent", np.array([4])),
}

ALL = np.ones(UAVS, dtype=bool)


def said(*, but: tuple[str, ...] = (), scale: float = 1.0) -> dict[str, np.ndarray]:
    """Numbers of all nodes `but` some, the last to have been asked first, as nobody has to keep the order."""
    numbers = np.random.default_rng(1).normal(0, scale, (UAVS, 5))
    return {name: numbers[member.uavs] for name, member in reversed(EVERYONE.items()) if name not in but}


@pytest.mark.parametrize("but", [(), ("agent-0",), ("agent-1", "leader-0"), tuple(EVERYONE)])
@pytest.mark.parametrize("asked", [list(EVERYONE), list(reversed(EVERYONE))])
def test_the_numbers_of_a_node_are_in_the_rows_of_its_uavs(but: tuple[str, ...], asked: list[str]) -> None:
    commands, before, after = Commands(UAVS, 3), said(scale=3.0), said(but=but)
    members = {name: EVERYONE[name] for name in asked}
    assert not len(commands.store(members, before, None, ALL))
    assert not len(commands.store(members, after, None, ALL))
    for name, member in EVERYONE.items():
        holds, told = commands.accelerations[member.uavs], commands.diagnostics[member.uavs]
        assert (holds == (after if name in after else before)[name][:, :2]).all()
        assert (told == (after[name][:, 2:] if name in after else 0.0)).all()
    ever = np.abs(np.concatenate([*before.values(), *after.values()]))
    assert commands.largest.tolist() == ever[:, 2:].max(axis=0).tolist()


def test_who_sleeps_is_not_taken_at_his_word() -> None:
    commands, awake = Commands(UAVS, 3), np.array([True, False, True, True, False])
    commands.store(EVERYONE, said(), awake, ALL)
    assert commands.accelerations.any(axis=-1).tolist() == awake.tolist()
    assert commands.diagnostics.any(axis=-1).tolist() == awake.tolist()
    assert (commands.largest == np.abs(commands.diagnostics).max(axis=0)).all()


@pytest.mark.parametrize("column", range(5))
@pytest.mark.parametrize("size", [BEYOND_SENSE, -BEYOND_SENSE, np.inf, np.nan])
def test_what_is_beyond_all_bounds_is_named_and_not_taken(size: float, column: int) -> None:
    commands, numbers = Commands(UAVS, 3), said()
    numbers["agent-1"][1, column] = size
    assert commands.store(EVERYONE, numbers, None, ALL).tolist() == [2]
    assert commands.accelerations.any(axis=-1).tolist() == [True, True, False, True, True]
    assert commands.largest.max() < BEYOND_SENSE


def test_where_all_are_beyond_nothing_is_taken() -> None:
    commands, numbers = Commands(UAVS, 3), {name: rows + np.inf for name, rows in said().items()}
    assert sorted(commands.store(EVERYONE, numbers, None, ALL)) == list(range(UAVS))
    assert not commands.accelerations.any()
    assert not commands.largest.any()


def test_diagnostics_of_those_on_the_way_add_up() -> None:
    commands, numbers, on_way = Commands(UAVS, 3), said(), np.array([True, False, True, True, False])
    commands.store(EVERYONE, numbers, None, on_way)
    commands.store(EVERYONE, numbers, None, ALL)
    twice = commands.diagnostics[on_way].sum(axis=0) + commands.diagnostics.sum(axis=0)
    np.testing.assert_allclose(commands.summed, twice, rtol=1e-12)
    summed, largest = commands.figures(["a", "b", "c"])
    assert list(summed.values()) == commands.summed.tolist()
    assert list(largest.values()) == commands.largest.tolist()
