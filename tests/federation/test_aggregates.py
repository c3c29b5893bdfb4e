"""What travels beside models, and what rules answer beside them: notes, rounds begun with, the end, bytes that grow."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

import meanflock as mf
from meanflock.federation.codec import HEAD_BYTES, Codec, Cut
from meanflock.federation.cut import coding_of
from meanflock.federation.inbox import Round
from meanflock.federation.ledger import Ledger
from meanflock.federation.memory import OwnModels
from meanflock.federation.plan import plan_of
from meanflock.federation.rounds import Rounds
from meanflock.federation.rules.base import Aggregate
from meanflock.launch.engine import Engine
from meanflock.results.run_folder import EVENTS, RunFolder
from meanflock.results.stored_run import stored_run
from meanflock.swarm.errors import BadInput, MessageRejected
from meanflock.swarm.events import RoundEnded
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire.messages import FrameKind, Frames
from meanflock.testing import check_aggregator
from meanflock.worldsim.checkpoint import EVERY_TICKS
from tests.federation.channels import Coin
from tests.federation.plugins import Long
from tests.memory_swarm import MemorySwarm
from tests.telemetry import fly

UAVS, LENGTH, ROUNDS = 6, 300, 7
CLEAR, DEAF = ("radio.model=ideal",), (f"radio.model={Coin.name}", "radio.options.loss=1.0")
CUT = "federation.fragment=1"


class Diary(Long):
    """A controller that keeps a diary: UAV 2 has no model, and trainings begin with the models of even rounds."""

    name = "diary"
    note_bytes = 12
    dated = True
    heard: ClassVar[list[tuple[int, list[bool], Sequence[bytes]]]] = []

    def init(self, uavs: np.ndarray, initial_states: np.ndarray) -> dict[str, Any]:
        return super().init(uavs, initial_states) | {"uav": uavs.astype(int), "began": np.zeros(len(uavs), dtype=int)}

    def ready(self, memory: dict[str, Any]) -> np.ndarray:
        return memory["uav"] != 2

    def based(self, memory: dict[str, Any]) -> np.ndarray:
        return memory["began"]

    def note(self, memory: dict[str, Any]) -> list[bytes]:
        return [f"{uav}@{began}".encode() for uav, began in zip(memory["uav"], memory["began"], strict=True)]

    def arrived(self, memory: dict[str, Any], rows: np.ndarray, arrival: Any) -> dict[str, Any]:
        self.heard.append((arrival.number, arrival.whole.tolist(), list(arrival.notes)))
        began = memory["began"].copy()
        began[rows] = 2 * (arrival.number // 2)
        model = memory["model"].copy()
        model[rows] = arrival.models
        return memory | {"model": model, "began": began}

    def set(self, memory: dict[str, Any], rows: np.ndarray, models: np.ndarray) -> dict[str, Any]:
        raise AssertionError("a controller that hears of arrivals needs no `set`")


class Scribe(mf.Aggregator):
    """Broadcasts a note with every model."""

    name = "scribe"
    note_bytes = 20
    read: ClassVar[list[tuple[int, list[int], tuple[bytes, ...], list[int]]]] = []

    def step(self, state: Any, uploads: mf.Uploads) -> Any:
        self.read.append((uploads.round, uploads.uavs.tolist(), uploads.notes, uploads.based.tolist()))
        return state, Aggregate(uploads.mean, b"r%d" % uploads.round)


class Verbose(Scribe):
    name = "verbose"

    def step(self, state: Any, uploads: mf.Uploads) -> Any:
        return state, Aggregate(uploads.mean, bytes(21))


class Clock(mf.Aggregator):
    """Broadcasts a model in every round, whether or not any came."""

    name = "clock"
    asked_void = True

    def init(self, parameters: int) -> Any:
        return {"rounds": np.zeros(1), "models": np.zeros(1)}

    def step(self, state: Any, uploads: mf.Uploads) -> Any:
        after = {"rounds": state["rounds"] + 1, "models": state["models"] + len(uploads.uavs)}
        assert after["rounds"][0] == uploads.round
        return after, np.full(uploads.models.shape[1], float(uploads.round))


class Enough(mf.Aggregator):
    """Is done after three rounds."""

    name = "enough"

    def init(self, parameters: int) -> Any:
        return {"rounds": np.zeros(1)}

    def step(self, state: Any, uploads: mf.Uploads) -> Any:
        after = {"rounds": state["rounds"] + 1}
        return after, Aggregate(uploads.mean, done=bool(after["rounds"][0] == 3))


class Growing(mf.Aggregator):
    """Keeps the rounds it has seen, five bytes each, which the models depend on."""

    name = "growing"
    state_bytes = 5 * ROUNDS

    def init(self, parameters: int) -> Any:
        return {"log": np.zeros(0, dtype=np.uint8), "last": np.zeros(1)}

    def step(self, state: Any, uploads: mf.Uploads) -> Any:
        log = np.append(state["log"][-5 * ROUNDS + 5 :], np.full(5, uploads.round % 256)).astype(np.uint8)
        return {"log": log, "last": np.array([float(uploads.round)])}, uploads.mean * (1.0 + 1e-3 * log.sum() / 256)


class Overgrown(Growing):
    name = "overgrown"
    state_bytes = 12


class Kept(mf.Aggregator):
    """Keeps its state in itself."""

    name = "kept"
    resumable = False

    def step(self, state: Any, uploads: mf.Uploads) -> Any:
        return state, uploads.mean


@pytest.fixture(autouse=True)
def _registered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("meanflock.launch.engine._CHECKPOINT_TICKS_AT_MOST", EVERY_TICKS)
    for plugin in (Coin, Long, Diary, Scribe, Verbose, Clock, Enough, Growing, Overgrown, Kept):
        mf.register(plugin)
    Diary.heard.clear()
    Scribe.read.clear()


def scenario(rule: type[mf.Aggregator], *settings: str, method: str = "long") -> Scenario:
    fixed = [f"uavs={UAVS}", f"controller.length={LENGTH}", 'stop="duration"', "duration=35", "federation.period=45"]
    fixed += [f"federation.aggregation={rule.name}", "federation.fraction=1.0"]
    return load(None, [*fixed, *settings], method=method, seed=6)


# -- beside a model -----------------------------------------------------------------------------------------------

HEAD = HEAD_BYTES + 20
NOTES = {  # settings, and the bits of an upload by hand
    "whole": ((), 32 * (LENGTH + 7)),
    "int8": (("federation.payload=int8",), 8 * (LENGTH + HEAD) + 3 * 32),
    "fragments": ((CUT, "federation.payload=int8"), None),
}


@pytest.mark.parametrize("how", NOTES)
def test_notes_and_rounds_begun_with_arrive_both_ways_and_are_billed(how: str) -> None:
    settings, bits = NOTES[how]
    case = scenario(Scribe, *CLEAR, *settings, method="diary")
    summary, _ = fly(case)
    codec, senders = plan_of(case).hops[0].codec, [0, 1, 3, 4, 5]
    assert (codec.count > 1) == (how == "fragments")
    assert summary["rounds"] == summary["uploads_silent"] == ROUNDS
    began = [2 * ((number - 1) // 2) for number in range(1, ROUNDS + 1)]
    notes = [tuple(b"%d@%d" % (uav, first) for uav in senders) for first in began]
    expected = [(k + 1, senders, notes[k], [began[k]] * len(senders)) for k in range(ROUNDS)]
    assert Scribe.read == expected
    told = [one for one in Diary.heard if len(one[1]) == UAVS]  # before take-off a UAV is tried
    assert [number for number, *_ in told] == list(range(1, ROUNDS + 1))
    for number, whole, heard in told:
        assert (whole, heard) == ([True] * UAVS, [b"r%d" % number] * UAVS)
    if bits is not None:
        assert codec.bits == bits
    assert summary["payload_bits"]["uplink"] == ROUNDS * 4 * codec.count * codec.bits  # the leader's own is free
    networked = MemorySwarm(case, "notes", uavs_per_node=4).complete()
    for field in ("models_sha256", "payload_bits", "dropped_messages"):
        assert networked[field] == summary[field]


def test_a_head_is_lost_with_its_fragment_and_an_own_model_has_none() -> None:
    codec = Codec(coding_of(Scenario(), "float64"), (4,), Cut(1, 4, 9), head=HEAD_BYTES + 3)
    models = codec.encode(np.arange(12.0).reshape(3, 4), np.arange(3), 5)
    heads = codec.heads(np.array([1, 2, 3]), [b"a", b"bcd", b""])
    rows, source = codec.rows(models, np.ones((3, 1)), None, heads), np.arange(3, dtype=np.int32).repeat(codec.count)
    lost = codec.count  # the first fragment of UAV 1
    links = np.array([[row, 9] for row in range(len(rows)) if row != lost], dtype=np.int32)
    mail = Round(0, codec, np.array([9]))
    mail.add(Frames(FrameKind.UPLOAD, 5, source, rows, links))
    round_ = mail.take(5, late=False)
    for uploads in (round_.all_uploads, round_.uploads(0)):
        assert uploads.notes == (b"a", b"", b"")
        assert uploads.based.tolist() == [1, 4, 3]  # that of UAV 1 is unknown: the round before
        assert uploads.arrived.all(axis=1).tolist() == [True, False, True]
    round_.own = OwnModels(codec, 1)
    assert round_.uploads(0).based.tolist() == [1, 4, 3, 4]
    assert round_.uploads(0).notes == (b"a", b"", b"", b"")


def test_a_note_that_is_longer_than_declared_costs_the_round() -> None:
    summary, record = fly(scenario(Verbose, *CLEAR))
    assert (summary["rounds"], summary["rounds_void"]) == (0, ROUNDS)
    assert any("a note of 21 bytes; `note_bytes` is 20" in text for text in record.texts)


# -- what rules answer --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("cut", ["federation.fragment=0", CUT])
def test_a_rule_that_is_asked_in_void_rounds_broadcasts_in_each(cut: str) -> None:
    case = scenario(Clock, *DEAF, cut, "federation.fraction=0.5")
    summary, record = fly(case)
    assert (summary["rounds"], summary["rounds_void"]) == (ROUNDS, 0)
    traffic, codec = summary["radio"]["traffic"], plan_of(case).hops[1].codec
    assert traffic["uplink"]["delivered"] == 0
    assert traffic["broadcast"]["transmissions"] == ROUNDS * codec.count
    assert not [text for text in record.texts if "failed" in text]


def test_after_a_rule_is_done_nothing_is_uploaded_or_billed_and_no_round_is_counted() -> None:
    case = scenario(Enough, *CLEAR)
    summary, record = fly(case)
    codec = plan_of(case).hops[0].codec
    assert (summary["rounds"], summary["rounds_void"], summary["uploads_silent"]) == (3, 0, 0)
    assert summary["payload_bits"]["uplink"] == 3 * 5 * codec.count * codec.bits
    assert summary["radio"]["traffic"]["broadcast"]["transmissions"] == 3 * codec.count
    assert [event.number for event in record.events if isinstance(event, RoundEnded)] == [1, 2, 3]
    resumed = [fly(case, resume=past)[0] for past in record.checkpoints[1:]]  # before and after the end
    others = [*resumed, fly(case, rows=2)[0], MemorySwarm(case, "done", uavs_per_node=4).complete()]
    for field in ("trajectory_sha256", "models_sha256", "payload_bits", "rounds", "rounds_void", "dropped_messages"):
        assert [other[field] for other in others] == [summary[field]] * len(others), field
    lost = scenario(Enough, *CLEAR, "faults=[{kind='leader-loss', tick=200}]")
    assert fly(lost)[0]["payload_bits"] == summary["payload_bits"]  # the standby knows it, too


@pytest.mark.parametrize("swarm", [Engine, MemorySwarm])
def test_a_flight_that_ends_with_its_rounds_is_finished_and_one_that_is_stopped_before_can_be_resumed(
    swarm: type[Engine | MemorySwarm], tmp_path: Path
) -> None:
    for name, rule, last, status in (
        ("whole", Enough, None, "finished"),
        ("stopped", Enough, 110, "interrupted"),
        ("without-checkpoint", Kept, 110, "interrupted"),
    ):
        case = scenario(rule, *CLEAR, 'stop="rounds"')
        folder = RunFolder(tmp_path, name, case)
        flight = swarm(case, name, sinks=[folder])
        for tick in flight.fly():
            assert tick < case.max_ticks
            if tick == last:
                break
        with folder:
            folder.summarise(flight.finish())
        run = stored_run(folder.path)
        kinds = [json.loads(line)["kind"] for line in (folder.path / EVENTS).read_text().splitlines()]
        assert (run.status, run.resumable) == (status, name == "stopped")
        assert kinds.count("finished") == (status == "finished")


def test_bytes_of_a_state_grow_and_are_in_checkpoints_and_in_the_leader_that_takes_over() -> None:
    check_aggregator(Growing)
    case = scenario(Growing, *CLEAR)
    summary, record = fly(case)
    assert summary["rounds"] == ROUNDS
    others = [fly(case, resume=past)[0] for past in record.checkpoints[1:]]
    others.append(fly(scenario(Growing, *CLEAR, "faults=[{kind='leader-loss', tick=200}]"))[0])
    others.append(MemorySwarm(case, "bytes", uavs_per_node=4).complete())
    for field in ("trajectory_sha256", "models_sha256", "rounds", "dropped_messages"):
        assert [other[field] for other in others] == [summary[field]] * len(others), field


def test_a_state_beyond_its_bytes_costs_the_round_and_one_in_every_uav_is_refused() -> None:
    summary, record = fly(scenario(Overgrown, *CLEAR))
    assert (summary["rounds"], summary["rounds_void"]) == (2, ROUNDS - 2)
    assert any("the state has 15 bytes; `state_bytes` is 12" in text for text in record.texts)
    with pytest.raises(BadInput, match=r"growing has a state whose length changes.*`federation.topology` to leader"):
        fly(scenario(Growing, "federation.topology=neighbours"))
    with pytest.raises(BadInput, match=r"kept has a state that is not in checkpoints.*`federation.topology` to leader"):
        fly(scenario(Kept, "federation.topology=neighbours"))


class Prophet(Diary):
    """Says that its trainings began with models of rounds that are to come."""

    name = "prophet"

    def based(self, memory: dict[str, Any]) -> np.ndarray:
        return memory["began"] + 99


def test_no_model_can_come_from_a_later_round_than_the_one_before() -> None:
    """A controller that says so uploads the latest possible round; a node that sends it all the same is not heard."""
    mf.register(Prophet)
    case = scenario(Scribe, *CLEAR, method="prophet")
    plan = plan_of(case)
    codec, ledger = plan.hops[0].codec, Ledger(plan)
    leader = Rounds(plan, "leader", np.zeros(0, dtype=np.intp), [])

    def upload(based: int) -> Frames:
        coded = codec.encode(np.ones((1, codec.floats)), np.array([1]), 3)
        heads = codec.heads(np.array([based]), [b""])
        rows = codec.rows(coded, np.ones((1, 1)), None, heads)
        source = np.ones(len(rows), dtype=np.int32)
        links = np.array([[row, case.federation.leader] for row in range(len(rows))], dtype=np.int32)
        return Frames(FrameKind.UPLOAD, 3, source, rows, links)

    for check in (lambda frames: ledger.check("agent", frames), leader.check):
        check(upload(2))
        with pytest.raises(MessageRejected, match="based on round 3, at most 2"):
            check(upload(3))
    Engine(case, "prophet").complete()
    assert [set(based) for *_, based in Scribe.read] == [{number - 1} for number, *_ in Scribe.read]
