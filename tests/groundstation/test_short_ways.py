"""Flights on which every plain message goes the short way are those on which all of them go the long one."""

from typing import Any

import pytest

from agent import kernel
from agent.node import Agent
from groundstation.engine import Engine
from swarm import codec, plain
from swarm.bus import MemoryBus
from swarm.messages import Frames
from swarm.methods import Method
from swarm.scenario import load
from swarm.state import States
from worldsim import inbox
from worldsim.barrier import Barrier
from worldsim.members import Member

pytestmark = pytest.mark.skipif(not kernel.is_compiled(), reason="installed without a C compiler")

FEDERATED = [str(method) for method in Method if method.is_federated]
SOMETIMES = ("radio.target_snr_db=76",)  # some messages are in outage
SLOW = ("radio.coherence_time_s=0.03", *SOMETIMES)  # and some a tick late or two
BYTES = ("federation.payload=int8", "federation.broadcast_payload=int8")
CLUSTERS = ("federation.clusters=2", *SLOW)
BYZANTINE = ("federation.byzantine_fraction=0.4", "federation.byzantine_kind=huge")
FAULTS = """faults=[{kind="kill", tick=20, uavs=[2]}, {kind="partition", tick=25, duration_s=3.0, uavs=[4]},
    {kind="leader-loss", tick=50}]""".replace("\n", " ")


def one_by_one(barrier: Barrier, members: list[Member], states: States, brought: Frames | None = None) -> None:
    heard = [] if brought is None else [brought]
    for member in members:
        barrier.ask(member, states[member.place], inbox.of_agent(member, heard, len(states)))


def fly(monkeypatch: pytest.MonkeyPatch, settings: tuple[str, ...], method: str, rows: int, *, short: bool) -> Any:
    """All that was said between world and nodes, what came of it, and how often an agent answered by reflex."""
    said: list[tuple[str, bytes]] = []
    reflexes = {"tried": 0, "answered": 0}
    put, reflex = MemoryBus.put, Agent.reflex

    def hear(self: MemoryBus, key: str, payload: bytes) -> None:
        if "/node/" in key:
            said.append((key, payload))
        put(self, key, payload)

    def counted(self: Agent, raw: bytes, tick: int) -> bytes | None:
        answer = reflex(self, raw, tick) if short else None
        reflexes["tried"] += 1
        reflexes["answered"] += answer is not None
        return answer

    with monkeypatch.context() as patch:
        patch.setattr(MemoryBus, "put", hear)
        patch.setattr(Agent, "reflex", counted)
        if not short:
            patch.setattr(plain, "encode", codec.encode)
            patch.setattr(Barrier, "ask_all", one_by_one)
            patch.setattr(Barrier, "overhear", lambda *_: False)
        fixed = ["uavs=6", "duration=6", "stop=duration", "federation.period=10"]
        engine = Engine(load(None, [*fixed, *settings], method=method), "short", uavs_per_node=rows)
        for _ in engine.fly():
            pass
        summary = engine.world.finish()
    return said, {k: v for k, v in summary.items() if k not in ("wall_time_s", "real_time_factor")}, reflexes


@pytest.mark.parametrize(
    ("method", "rows", "settings"),
    [
        ("mfgfl-h", 2, ()),
        ("mfgfl-f", 6, SLOW),
        ("mfgfl-h", 1, ("federation.payload=int8", *SOMETIMES)),
        ("mfgfl-f", 1, CLUSTERS),
        ("mfgfl-hf", 1, SLOW),
        ("mfgfl-hf", 1, (*BYTES, *SOMETIMES)),
        ("mfgfl-hf", 2, ("federation.payload=float16", "federation.error_feedback=false")),
        ("mfgfl-hf", 1, ("radio.bits_per_float=64", *BYZANTINE)),
        ("mfgfl-hf", 1, ("federation.fraction=0.5", *CLUSTERS)),
        ("mfgfl-hf", 6, CLUSTERS),
        ("mfgfl-hf", 1, (FAULTS, *SOMETIMES)),
        ("mfgfl-hf", 2, (FAULTS, *BYTES)),
        ("mfgfl-hf", 1, ("federation.period=1",)),
        ("mfgfl-hf", 3, ("federation.period=3", "federation.aggregation=median")),
    ],
    ids=str,
)
def test_both_ways_say_and_do_the_same(
    method: str, rows: int, settings: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    said, summary, reflexes = fly(monkeypatch, settings, method, rows, short=True)
    long_said, long_summary, _ = fly(monkeypatch, settings, method, rows, short=False)
    assert said == long_said
    assert summary == long_summary
    assert summary["rounds"] >= 4
    assert reflexes["answered"] > 0


@pytest.mark.parametrize("method", FEDERATED)
def test_where_nothing_is_lost_no_tick_takes_the_long_way(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    _, summary, reflexes = fly(monkeypatch, (), method, 1, short=True)
    assert summary["rounds"] == 5
    assert reflexes["answered"] == 6 * 60  # of a checkpoint either: it keeps what a report tells
