"""Memories of nodes at a checkpoint: joined by row, and refused where they do not fit."""

import numpy as np
import pytest

from meanflock.swarm.declared import MAX_MEMORY_BYTES
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.wire.messages import Join
from meanflock.worldsim.checkpoint import Memories
from meanflock.worldsim.members import Member, Members

UAVS = 100


@pytest.fixture
def two() -> tuple[Member, Member]:
    members = Members(UAVS, 0)
    return members.admit(Join("agent", 2), 0.0), members.admit(Join("agent", 1), 0.0)


def reply(rows: int, first: float = 0.0) -> dict[str, np.ndarray]:
    return {"model": first + np.arange(3.0 * rows).reshape(rows, 3), "tick": np.full(rows, 7, dtype=np.int32)}


def test_memories_are_joined_by_row_and_missing_ones_are_zero(two: tuple[Member, Member]) -> None:
    memories = Memories(UAVS)
    memories.take(two[1], reply(1, 9.0))
    memories.take(two[0], reply(2))
    assert memories.arrays["model"][:3].tolist() == [[0.0, 1.0, 2.0], [3.0, 4.0, 5.0], [9.0, 10.0, 11.0]]
    assert memories.arrays["tick"].tolist() == [7, 7, 7, *[0] * (UAVS - 3)]
    assert memories.present.tolist() == [True] * 3 + [False] * (UAVS - 3)


@pytest.mark.parametrize(
    ("record", "reason"),
    [
        ({"model": np.zeros((2, 3))}, "wrong-shape"),
        ({"model": "learned"}, "wrong-shape"),
        ({"model": np.zeros((1, MAX_MEMORY_BYTES // 8 // UAVS)), "more": np.zeros((1, 1))}, "oversized"),
    ],
)
def test_a_reply_that_is_no_memory_is_refused_and_the_next_one_is_stored(
    record: dict, reason: str, two: tuple[Member, Member]
) -> None:
    memories = Memories(UAVS)
    with pytest.raises(MessageRejected) as caught:
        memories.take(two[1], record)
    assert caught.value.reason == reason
    memories.take(two[0], reply(2))
    assert memories.present.sum() == 2


@pytest.mark.parametrize(
    "record",
    [
        {},
        reply(1) | {"more": np.zeros(1)},
        reply(1) | {"model": np.zeros((1, 4))},
        reply(1) | {"tick": np.zeros(1)},
    ],
)
def test_a_memory_unlike_the_others_is_refused_and_changes_nothing(record: dict, two: tuple[Member, Member]) -> None:
    memories = Memories(UAVS)
    memories.take(two[0], reply(2))
    before = {name: array.copy() for name, array in memories.arrays.items()}
    with pytest.raises(MessageRejected, match="as of the others"):
        memories.take(two[1], record)
    assert not memories.present[2:].any()
    for name, array in memories.arrays.items():
        np.testing.assert_array_equal(array, before[name])
