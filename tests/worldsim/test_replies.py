"""What a tick brings the world and what the world tells: replies, frames and memories; links, blocks, checkpoints."""

from typing import Any

import numpy as np
import pytest

from meanflock.channel.meter import Meter
from meanflock.federation.ledger import Ledger
from meanflock.federation.plan import plan_of
from meanflock.launch.engine import Engine
from meanflock.launch.station import StoredTelemetry
from meanflock.net import keys
from meanflock.net import tick as wire
from meanflock.net.barrier import Barrier, Replies
from meanflock.net.bus import MemoryNetwork
from meanflock.net.members import Member
from meanflock.net.outbox import MAX_WAITING_BYTES
from meanflock.swarm.declared import MAX_BROADCASTS, most_memory
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.state import BEYOND_SENSE
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import Act, FrameKind, Frames
from meanflock.worldsim import checkpoint
from meanflock.worldsim.checkpoint import Assembly, Memories, split
from meanflock.worldsim.commands import Commands
from meanflock.worldsim.merger import FrameMerger
from meanflock.worldsim.reporting import STATE_LINKS_EVERY_TICKS
from tests.faults.dying import dead, resumed
from tests.swarm.examples import same
from tests.telemetry import fly

NAME, TICK = "replies", 20
RUN = keys.fingerprint(NAME)
STATES = load(None, ["uavs=8"], method="hjb")
ALL = load(None, ["uavs=8", "federation.period=10", "federation.fraction=1.0"], method="mfgfl-hf")
MOST = plan_of(STATES).declared.broadcast_numbers  # of a UAV in a tick
INTEGERS = ("i1", "u1", "<i2", "<i4")
WIDTH = 2 + len(plan_of(STATES).declared.diagnostics)


def member(*uavs: int) -> Member:
    return Member(f"agent-{uavs[0]}", "agent", np.array(uavs))


def readers(flown: Scenario) -> Replies:
    return Replies(plan_of(flown), RUN, Ledger(plan_of(flown)), lambda rows: 2**16)


def broadcast(*uavs: int, dtype: Any = "<f4", width: int = 4, number: int = 0) -> Frames:
    payload = np.random.default_rng(len(uavs) + width).integers(0, 99, (len(uavs), width)).astype(dtype)
    return Frames(FrameKind.STATE, number, np.array(uavs, np.int32), payload)


def test_broadcasts_of_any_width_and_type_of_some_rows_are_accepted() -> None:
    frames = [broadcast(3, 5, dtype=name, width=width, number=width) for width, name in enumerate(INTEGERS, 1)]
    frames += [broadcast(2, width=MOST), broadcast(2, 5, number=MAX_BROADCASTS - 1)]
    act = Act(RUN, TICK, np.full((3, WIDTH), 0.25), outbox=tuple(frames))
    same(readers(STATES).read(member(2, 3, 5), TICK, wire.write_act(act)), act)


def test_commands_stand_in_the_rows_of_their_uavs_and_the_last_reply_wakes_the_waiting_thread() -> None:
    barrier, both = Barrier(MemoryNetwork().endpoint(), NAME, readers(STATES)), (member(1, 4), member(2))
    barrier.open(TICK, reporting=False)
    for node in both:
        barrier.ask(node, np.zeros((node.rows, 4)))
    raws = [wire.write_act(Act(RUN, TICK, np.full((node.rows, WIDTH), 1.0 + node.rows))) for node in both]
    assert barrier.offer(keys.act(NAME, "agent-1"), raws[0])
    assert not barrier.offer(keys.act(NAME, "agent-1"), raws[0])  # it counts once
    assert not barrier.offer(keys.act(NAME, "agent-2"), raws[1])  # the last one is left to the waiting thread
    barrier.take(both[1], raws[1])
    assert not barrier.silent
    assert barrier.replied.tolist() == [False, True, True, False, True, False, False, False]
    assert barrier.commands[[1, 2, 4], 0].tolist() == [3.0, 2.0, 3.0]


def upload(flown: Scenario, *uavs: int, number: int = 2) -> Frames:
    codec, source = plan_of(flown).hops[0].codec, np.array(uavs, np.int32)
    models = np.random.default_rng(uavs[0]).normal(size=(len(uavs), codec.floats))
    rows = codec.rows(codec.encode(models, source, number), np.ones((len(uavs), 1)))
    return Frames(FrameKind.UPLOAD, number, source, rows)


def test_uploads_of_a_round_are_one_batch_billed_by_its_bytes_without_other_rounds_and_silent_uavs() -> None:
    meter, merger = Meter(ALL.radio, ALL.uavs), FrameMerger(Ledger(plan_of(ALL)))
    batches = [upload(ALL, 1, number=3), upload(ALL, 0), upload(ALL, 2, 3), upload(ALL, 4), upload(ALL, 5, number=1)]
    (merged,), rejected = merger.merged(TICK, batches, ~np.isin(np.arange(8), [3, 4]), meter)
    kept = [upload(ALL, 0), upload(ALL, 2, 3)]
    assert (merged.kind, merged.round, merged.links) == (FrameKind.UPLOAD, 2, None)  # not that of the first batch
    assert merged.source.tolist() == [0, 2]
    np.testing.assert_array_equal(merged.payload, np.concatenate([each.payload[:1] for each in kept]))
    assert [where for _, where in rejected] == ["frames of UAV 1", "frames of UAV 5"]
    assert meter.traffic[FrameKind.UPLOAD].wire_bytes == 2 * upload(ALL, 0).wire_bytes
    assert merger.merged(TICK, batches[:1], np.ones(8, dtype=bool), meter)[0] == []


@pytest.mark.parametrize("column", range(5))
@pytest.mark.parametrize("size", [BEYOND_SENSE, -BEYOND_SENSE, np.inf, np.nan])
def test_a_command_beyond_the_bound_is_named_and_not_used(size: float, column: int) -> None:
    commands, given, each = Commands(5, 2, 3), np.random.default_rng(1).normal(size=(5, 5)), np.ones(5, dtype=bool)
    given[2, column] = given[4, 0] = size
    assert commands.store(given, np.arange(5) != 4, each, each).tolist() == [2]  # 4 has not replied
    assert commands.accelerations.any(axis=-1).tolist() == [True, True, False, True, False]
    commands.settle()
    assert commands.largest.max() < BEYOND_SENSE


ROWS = 100


def memory(rows: int, first: float = 0.0) -> dict[str, np.ndarray]:
    return {"model": first + np.arange(3.0 * rows).reshape(rows, 3), "tick": np.full(rows, 7, dtype=np.int32)}


WRONG_MEMORIES: list[tuple[dict[str, Any], str]] = [
    ({"model": np.zeros((2, 3))}, "wrong-shape"),  # the first three may come first of all
    ({"model": "learned"}, "wrong-shape"),
    ({"model": np.zeros((1, most_memory(ROWS) // 8 // ROWS)), "more": np.zeros((1, 1))}, "oversized"),
    ({}, ".*as of the others"),
    (memory(1) | {"more": np.zeros(1)}, ".*as of the others"),
    (memory(1) | {"model": np.zeros((1, 4))}, ".*as of the others"),
    (memory(1) | {"tick": np.zeros(1)}, ".*as of the others"),
]


def test_memories_are_joined_by_row_and_a_wrong_one_is_refused_and_changes_nothing() -> None:
    memories = Memories(plan_of(STATES.replace(uavs=ROWS)).groups)
    for record, reason in WRONG_MEMORIES[:3]:
        with pytest.raises(MessageRejected, match=f"^{reason}"):
            memories.take(np.array([3]), record)
    memories.take(np.array([2]), memory(1, 9.0))
    memories.take(np.arange(2), memory(2))
    for record, reason in WRONG_MEMORIES[3:]:
        with pytest.raises(MessageRejected, match=f"^{reason}"):
            memories.take(np.array([3]), record)
    assert memories.arrays[0]["model"][:3].tolist() == [[0.0, 1.0, 2.0], [3.0, 4.0, 5.0], [9.0, 10.0, 11.0]]
    assert memories.arrays[0]["tick"].tolist() == [7, 7, 7, *[0] * (ROWS - 3)]
    assert memories.present.tolist() == [True] * 3 + [False] * (ROWS - 3)


@pytest.mark.parametrize(
    ("method", "changes"),
    [
        ("hjb", []),
        ("hjb", ["radio.target_snr_db=60"]),  # nothing is lost
        ("mfgfl-hf", ["federation.state_period=3", "federation.period=7"]),
        ("mfgfl-hf", ["federation.period=7"]),
    ],
)
def test_telemetry_has_all_outages_and_models_and_a_sample_of_states(method: str, changes: list[str]) -> None:
    flown = load(None, ["uavs=5", "duration=6", "radio.target_snr_db=77", *changes], method=method)
    engine, used = Engine(flown, "telemetry", sinks=[kept := StoredTelemetry()]), []
    send = engine.world.air.send

    def noted(*given: Any) -> np.ndarray:
        used.append(send(*given).copy())
        return used[-1]

    engine.world.air.send = noted
    engine.complete()
    links = np.concatenate(used)
    sampled = (links[:, 0] + 1) % STATE_LINKS_EVERY_TICKS == 0
    expected = links[sampled | (links[:, 5] == 0) | (links[:, 3] != FrameKind.STATE)]
    np.testing.assert_array_equal(np.concatenate([block.links for block in kept.blocks]), expected)
    assert sampled.any()
    assert (links[:, 5] == 0).any() == ("radio.target_snr_db=60" not in changes)


def test_blocks_of_a_large_swarm_fit_into_a_message_and_several_may_wait() -> None:
    ticks = 8
    flown = load(None, ["uavs=60000", f"duration={ticks / 10}"], method="cruise")
    _, kept = fly(flown)
    sizes = [len(control.encode(block)) for block in kept.blocks]
    assert sum(len(block.states) for block in kept.blocks) == ticks + 1
    assert 5 < max(len(block.states) for block in kept.blocks) < ticks
    assert max(sizes) < min(control.MAX_BYTES, MAX_WAITING_BYTES) // 3


def test_a_long_checkpoint_is_sent_in_parts_and_joined(monkeypatch: pytest.MonkeyPatch) -> None:
    body = bytes(range(1, 100))
    assert split(body) == [body]
    monkeypatch.setattr(checkpoint, "PART_BYTES", 40)
    first, second, third = split(body)
    whole = Assembly()
    assert [whole.add(part) for part in (first, third, second)] == [None, None, None]  # one is missing
    assert [whole.add(part) for part in (first, second, first, second, third)] == [None] * 4 + [body]
    assert whole.add(body) == body
    assert whole.begun


def test_a_run_whose_checkpoints_go_in_parts_resumes_to_the_same_bits(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(checkpoint, "PART_BYTES", 500)
    flown = load(None, ["uavs=4", "duration=120", 'stop="duration"'], method="mfgfl-h")
    killed = dead(tmp_path, flown, 1150)
    assert resumed(killed)["trajectory_sha256"] == Engine(flown, "whole").complete()["trajectory_sha256"]
