"""Rows of an agent that go wrong: controllers of strangers, their checkpoints, and numbers beyond all bounds."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from meanflock.agent import node
from meanflock.agent.controllers.base import Broadcast, Controller, Memory, Received, Step
from meanflock.agent.node import Agent
from meanflock.launch import engine
from meanflock.launch.engine import Engine
from meanflock.net import tick as wire
from meanflock.swarm import plugins
from meanflock.swarm.errors import BadInput
from meanflock.swarm.plugins import registry
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire.messages import Act, Status
from meanflock.worldsim import reporting, world
from tests.agent import nodes
from tests.memory_swarm import MemorySwarm
from tests.telemetry import Record, fly
from tests.testing.good import GoodController

BAD, WHEN = 2, 7  # the UAV whose controller goes wrong, and the tick it does in
UAVS = 5
QUIET = "radio.target_snr_db=60"  # nothing is lost on the way


class Honest(GoodController):
    """Flies to the destination by what it learns on the way, and remembers more; the base of the wrong controllers."""

    name = "stranger"
    weights = 4
    period_ticks = 5

    def init(self, uavs: np.ndarray, plan: np.ndarray) -> Memory:
        rows = len(uavs)
        return super().init(uavs, plan) | {"ticks": np.zeros(rows, np.int64), "aside": np.ones((rows, 2, 3))}

    def step(self, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        good, model = super().step(memory, tick, own, received), memory["model"]
        after = good.memory | {"ticks": memory["ticks"] + 1, "model": model + 1e-3 * own[:, :3]}
        return replace(good, memory=after, acceleration=good.acceleration + 0.01 * model[:, :2])

    def report(self, memory: Memory) -> np.ndarray:
        return np.concatenate([memory["model"], memory["ticks"][:, None]], axis=1)

    def is_time(self, memory: Memory) -> bool:
        return bool(((memory["uav"] == BAD) & (memory["ticks"] >= WHEN)).any())


def flown(controller: type[Controller], *settings: str) -> Scenario:
    plugins.register(controller)
    return load(None, [f"uavs={UAVS}", "duration=3", 'stop="duration"', *settings], method=controller.name)


def wrong(**methods: Any) -> type[Controller]:
    return type("Wrong", (Honest,), methods)


def returns(name: str, spoil: Any) -> dict[str, Any]:
    """A method whose answer is spoiled in time."""

    def method(self: Honest, memory: Memory, *more: Any) -> Any:
        good = getattr(Honest, name)(self, memory, *more)
        return spoil(good) if self.is_time(memory) else good

    return {name: method}


def stepping(**fields: Any) -> dict[str, Any]:
    """A step with other fields in time; each is a function of the good step and the mask of the bad UAV."""
    return returns("step", lambda good: replace(good, **{name: make(good) for name, make in fields.items()}))


def weighing(weight: float) -> dict[str, Any]:
    """A model whose weight is a number in time."""
    return {"weighted": True} | returns("samples", lambda good: good * weight)


def explodes(*_: Any) -> Any:
    raise OSError("no such table")


BEGINS_WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "raises when it is made": ({"__init__": explodes}, r"be made: OSError: no such table \(test_going_wrong.py, line"),
    "raises in init": ({"init": explodes}, r"failed in `init` with UAV 0: OSError: no such table"),
    "remembers no dict": ({"init": lambda *_: [1, 2]}, r"memory is a list; expected a dict of arrays"),
    "remembers other rows": ({"init": lambda *_: {"model": np.zeros((3, 2))}}, r"a leading axis of 5 rows"),
    "remembers complex numbers": ({"init": lambda *_: {"model": np.zeros((5, 2), "c16")}}, r"keeps arrays of bool,"),
    "remembers large integers": ({"init": lambda *_: {"n": np.zeros(5, np.uint64)}}, r"memory\['n'\] is uint64 "),
    "declares a truth": ({"parameters": True}, r"`parameters` is True"),
    "declares too much": ({"parameters": 10**9}, r"`parameters` is 1000000000; expected a whole number of 0 … 1000000"),
    "declares parts that do not add up": ({"parts": (1, 1)}, r"`parts` \(1, 1\) do not add up to its 3"),
    "declares no period": ({"period_ticks": 0}, r"`period_ticks` is 0"),
    "declares a text of diagnostics": ({"diagnostics": "speed"}, r"is a text; write \('speed',\)"),
    "declares a diagnostic twice": ({"diagnostics": ("a", "a")}, r"different names"),
    "has a model of another size": ({"get": lambda _, memory: memory["model"][:, :1]}, r"\(1, 1\); expected \(1, 3\)"),
    "has no model": ({"get": Controller.get}, r"declares `parameters` must override `get`"),
    "loses its memory": (
        {"set": lambda *_: None},
        r"failed in `set` with UAV 0: TypeError: memory is a NoneType; expected",
    ),
    "takes no model": ({"set": Controller.set}, r"declares `parameters` must override `set`"),
    "fails to declare": ({"parameters": property(explodes)}, r"a declaration cannot be read: OSError"),
}


@pytest.mark.parametrize("mistake", BEGINS_WRONG)
def test_a_controller_that_cannot_begin_is_bad_input_of_one_line(mistake: str) -> None:
    attributes, text = BEGINS_WRONG[mistake]
    with pytest.raises(BadInput, match=text) as caught:
        Engine(flown(wrong(**attributes)), "strangers")
    assert "'stranger'" in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def spoiled(good: Step, array: np.ndarray, number: float) -> np.ndarray:
    array = array.copy()
    array[good.memory["uav"] == BAD] = number
    return array


def said(payload: Any) -> dict[str, Any]:
    """A step with another broadcast; `payload` is a function of the number of rows."""
    return stepping(broadcasts=lambda good: (Broadcast(payload(len(good.acceleration))),))


# What goes wrong: the methods of the controller, and a part of the text of the event.
GOES_WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "raises": (returns("step", lambda _: 1 / 0), "ZeroDivisionError: division by zero"),
    "exits": (returns("step", lambda _: exit(3)), "SystemExit: 3 (test_going_wrong.py, line"),
    "returns nothing": (returns("step", lambda _: None), "`step` returns a NoneType; expected mf.Step("),
    "an acceleration that is no number": (
        stepping(acceleration=lambda good: spoiled(good, good.acceleration, np.nan)),
        "its acceleration along x is nan",
    ),
    "no diagnostics": (stepping(diagnostics=lambda _: None), "no diagnostics"),
    "an infinite diagnostic": (
        stepping(diagnostics=lambda good: spoiled(good, good.diagnostics, np.inf)),
        "its heard is inf",
    ),
    "a memory without an array": (stepping(memory=lambda good: {"uav": good.memory["uav"]}), "memory"),
    "a memory that is not finite": (
        stepping(memory=lambda good: good.memory | {"aside": spoiled(good, good.memory["aside"], np.nan)}),
        "ValueError: memory['aside'] has numbers that are not finite",
    ),
    "a broadcast of nothing": (said(lambda rows: np.zeros((rows, 0))), "0)"),
    "a broadcast too wide": (said(lambda rows: np.zeros((rows, 5000))), "5000"),
    "a broadcast of texts": (said(lambda rows: np.full((rows, 1), "x")), "a broadcast of"),
    "a broadcast of lists": (said(lambda rows: [[1.0]] * rows), "a broadcast of a list"),
    "too many broadcasts": (stepping(broadcasts=lambda good: good.broadcasts[:1] * 17), "17 broadcasts"),
    "no tuple of broadcasts": (stepping(broadcasts=lambda good: good.broadcasts[0]), "of mf.Broadcast"),
    "an array of broadcasts": (stepping(broadcasts=lambda good: good.acceleration), "of mf.Broadcast"),
    "refuses a UAV beyond the last": (stepping(refused=lambda _: np.array([0, UAVS])), "`refused` names UAVs from 0"),
    "refuses a table": (stepping(refused=lambda _: np.zeros((1, 2), int)), "no array of numbers of UAVs"),
    "get raises": (returns("get", explodes), "OSError: no such table"),
    "get of another shape": (returns("get", lambda good: good[:, :1]), "result of `get` has shape"),
    "set raises": (returns("set", explodes), "OSError: no such table"),
    "report that is no number": (returns("report", lambda good: good + np.inf), "not finite"),
    "a model beyond all bounds": (returns("get", lambda good: good * 0 + 1e39), "result of `get` has 1e+39; expected"),
    "a report beyond all bounds": (returns("report", lambda good: good * 0 - 1e31), "of `report` has -1e+31; expected"),
    "a weight of nothing": (weighing(0.0), "result of `samples` has 0; a weight is sent as float32"),
    "a weight too small for float32": (weighing(np.exp(-110)), "result of `samples` has 1.68891e-48; a weight is"),
    "a weight too large for a mean": (weighing(5e34), "result of `samples` has 5e+34; a weight is sent as float32"),
}


@pytest.mark.parametrize("weight", [1e-45, 9.99e29])
def test_the_smallest_and_the_largest_weight_of_a_float32_are_averaged(weight: float) -> None:
    summary, sink = fly(flown(wrong(**weighing(weight)), "federation.fraction=1.0", QUIET))
    assert (summary["lost"], summary["dropped_messages"], summary["uploads_refused"]) == (0, {}, 0)
    assert summary["rounds"] == 5
    assert not [line for line in sink.texts if "failed" in line]


def test_a_model_beyond_the_radio_s_floats_loses_its_own_uav() -> None:
    """A half ends at 65504."""
    narrow = "radio.bits_per_float=16"
    for size, lost in ((65504.0, 0), (65505.0, 1)):
        large = wrong(**returns("get", lambda good, size=size: good * 0 + size))
        summary, sink = fly(flown(large, "federation.fraction=1.0", QUIET, narrow))
        assert (summary["lost"], summary["dropped_messages"]) == (lost, {})
        assert sum("`get` has 65505; expected numbers within ±65504" in line for line in sink.texts) == lost


@pytest.mark.parametrize("mistake", GOES_WRONG)
def test_a_controller_that_goes_wrong_costs_its_own_uav_in_one_process_as_in_many(mistake: str) -> None:
    methods, text = GOES_WRONG[mistake]
    case = flown(wrong(**methods), "federation.fraction=1.0", QUIET)
    together, alone = fly(case), fly(case, rows=1)
    for summary, sink in (together, alone):
        assert summary["ticks"] == 30
        assert summary["dropped_messages"] == {}
        assert summary["nodes_lost"] == 0
        assert sum(bool(block.checkpoint) for block in sink.blocks) >= 2
        last = sink.blocks[-1].status[-1]
        assert (last == Status.LOST).tolist() == [uav == BAD for uav in range(UAVS)]
        (lost,) = [event.text for event in sink.events if event.kind == "diverged"]
        assert f"UAV {BAD}" in lost
        (named,) = [line for line in sink.texts if "failed with UAV" in line]
        assert f"UAV {BAD}: " in named
        assert text in named
    assert together[0]["trajectory_sha256"] == alone[0]["trajectory_sha256"]
    for one, other in zip(together[1].blocks, alone[1].blocks, strict=True):
        np.testing.assert_array_equal(one.diagnostics, other.diagnostics)


def test_a_memory_that_is_not_finite_costs_its_uav_also_in_a_flight_without_checkpoints() -> None:
    spoil = stepping(memory=lambda good: good.memory | {"aside": spoiled(good, good.memory["aside"], np.nan)})
    case = flown(wrong(**spoil), QUIET)
    without, (with_, _) = Engine(case, "none").complete(), fly(case, rows=1)
    assert without["lost"] == 1
    assert without["trajectory_sha256"] == with_["trajectory_sha256"]


@pytest.mark.parametrize(("column", "name"), [(2, "acceleration along z"), (3, "heard")])
def test_a_number_beyond_all_bounds_is_named_also_in_space(column: int, name: str) -> None:
    class InSpace(Controller):
        name, dimensions, diagnostics = "in-space", (3,), ("heard",)

        def init(self, uavs: np.ndarray, plan: np.ndarray) -> Memory:
            return {"uav": uavs.copy()}

        def step(self, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
            numbers = np.zeros((len(own), 4))
            numbers[memory["uav"] == BAD, column] = 1e40
            return Step(memory, numbers[:, :3], numbers[:, 3:])

    _, sink = fly(flown(InSpace, "space.dimensions=3"))
    assert f"agent-0: controller 'in-space' failed with UAV {BAD}: its {name} is 1e+40" in sink.texts


def test_a_uav_that_refuses_itself_is_not_lost_and_writing_to_the_numbers_of_init_does_no_harm() -> None:
    def init(self: Honest, uavs: np.ndarray, plan: np.ndarray) -> Memory:
        memory = Honest.init(self, uavs, plan)
        uavs += 1
        return memory

    def step(self: Honest, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        return replace(Honest.step(self, memory, tick, own, received), refused=memory["uav"])

    hashes = set()
    for rows in (None, 1):
        summary, _ = fly(flown(wrong(init=init, step=step), QUIET), rows)
        assert (summary["lost"], summary["nodes_lost"], summary["dropped_messages"]) == (0, 0, {})
        hashes.add(summary["trajectory_sha256"])
    assert hashes == {fly(flown(Honest, QUIET))[0]["trajectory_sha256"]}


def test_a_controller_that_fails_for_all_rows_together_and_for_none_alone_loses_no_uav_and_says_so_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    def in_company(self: Honest, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        if len(own) > 1:
            raise RuntimeError("too many")
        return Honest.step(self, memory, tick, own, received)

    strange, honest = fly(flown(wrong(step=in_company))), fly(flown(Honest))
    assert strange[0]["trajectory_sha256"] == honest[0]["trajectory_sha256"]
    assert strange[0]["lost"] == 0
    (warned,) = [record.getMessage() for record in caplog.records if "stepped alone" in record.getMessage()]
    assert "failed for 5 UAVs together and for none alone" in warned
    assert "RuntimeError: too many (test_going_wrong.py, line" in warned


@pytest.fixture(autouse=True)
def _often(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine, "_checkpoint_every", lambda *_: 10)
    monkeypatch.setattr(node, "MEMORY_TICKS", 10)


def test_a_checkpoint_of_another_version_of_the_plugin_is_refused_by_name() -> None:
    case = flown(Honest, "duration=3")
    past = fly(case)[1].checkpoints[-1]
    plugin, controller = registry.registered["controller", "stranger"]
    registry.registered["controller", "stranger"] = plugin._replace(fingerprint="sha256 of another file"), controller
    with pytest.raises(BadInput, match=r"controller 'stranger' of this process; here it is of sha256 of another"):
        Engine(case, "strangers", resume=past)


def test_a_checkpoint_whose_arrays_are_not_those_of_the_plugin_is_refused_with_the_uavs() -> None:
    past = fly(flown(Honest, "duration=3"))[1].checkpoints[-1]
    other = wrong(init=lambda self, uavs, plan: Honest.init(self, uavs, plan) | {"more": np.zeros(len(uavs))})
    with pytest.raises(BadInput, match=r"UAVs 0, 1, 2, 3, 4.* does not fit this controller: .*'more'"):
        Engine(flown(other, "duration=3"), "strangers", resume=past)


def test_a_memory_too_large_for_a_checkpoint_is_not_stored_and_the_flight_goes_on_and_says_so_once(monkeypatch) -> None:
    for room in (node, world):
        monkeypatch.setattr(room, "most_memory", lambda uavs: 2**20)
    large = wrong(init=lambda self, uavs, plan: Honest.init(self, uavs, plan) | {"map": np.zeros((len(uavs), 100_000))})
    on_a_bus = Record()
    MemorySwarm(flown(large, "duration=3"), "strangers", uavs_per_node=2, sinks=[on_a_bus]).complete()
    for rows in (None, 1):
        summary, sink = fly(flown(large, "duration=3"), rows=rows)
        assert (summary["ticks"], summary["lost"], summary["dropped_messages"]) == (30, 0, {})
        for record in (sink, on_a_bus):
            assert not any(block.checkpoint for block in record.blocks)
            assert [(event.tick, event.text) for event in record.events if event.kind == "checkpoint"] == [
                (
                    1,
                    "no checkpoint is stored: the memory of controller 'stranger' does not fit into 1 MiB for 5 UAVs; "
                    "a run without one cannot be resumed",
                )
            ]


def test_a_state_of_the_world_too_large_for_a_checkpoint_is_said_once(monkeypatch) -> None:
    monkeypatch.setattr(reporting, "most_bytes", lambda uavs: 1000)
    _, sink = fly(flown(Honest, "duration=3"))
    assert not any(block.checkpoint for block in sink.blocks)
    (event,) = [event for event in sink.events if event.kind == "checkpoint"]
    assert event.text.startswith("no checkpoint is stored: its 0.0")


def test_a_lost_agent_is_no_memory_that_is_too_large() -> None:
    _, sink = fly(flown(Honest, "duration=3", "faults=[{kind='kill',tick=8,uavs=[1]}]"), rows=1)
    assert sink.checkpoints
    assert "checkpoint" not in [event.kind for event in sink.events]


@pytest.mark.parametrize("method", ["hjb", "mfgfl-hf"])
def test_a_row_that_diverges_is_silenced_for_good_and_reported_and_the_others_never_notice(method: str) -> None:
    case = nodes.flown(method=method)
    agent, honest = Agent(nodes.welcome(case)), Agent(nodes.welcome(case))
    silent = []
    for tick in range(14):
        states = nodes.states_at(tick)
        if 3 <= tick < 12:  # the state returns, the row does not
            states[1] = [1e8, -1e8, 1e8, 1e8]
        act, expected = agent.act(nodes.sense(tick, states=states)), honest.act(nodes.sense(tick))
        assert isinstance(wire.read_act(wire.write_act(act)), Act)  # finite, whatever happens
        np.testing.assert_array_equal(act.commands[[0, 2]], expected.commands[[0, 2]])
        np.testing.assert_array_equal(act.models[[0, 2]], expected.models[[0, 2]])
        if len(act.lost):
            assert act.lost.tolist() == [3]
            assert not act.commands[1].any()
            assert not act.models[1].any()
            silent.append([batch.source.tolist() for batch in act.outbox])
    assert act.lost.tolist() == [3], "it never diverged"
    assert all(3 not in source for said in silent[1:] for source in said)


def test_a_state_beyond_the_radio_s_floats_is_not_sent_and_the_others_are() -> None:
    """A half ends at 65504. The world would drop an Act with a number that is not finite."""
    agent = Agent(nodes.welcome(nodes.flown("radio.bits_per_float=16", "sharing.policy=tick", method="vasarhelyi")))
    agent.act(nodes.sense(0))  # the mission plan is in the place of its broadcast
    states = nodes.states_at(1)
    states[1, 0] = 7e4
    with np.errstate(over="ignore"):
        act = agent.act(nodes.sense(1, states=states))
    assert isinstance(wire.read_act(wire.write_act(act)), Act)
    assert ([batch.source.tolist() for batch in act.outbox], len(act.lost)) == ([[2, 5]], 0)


@pytest.mark.parametrize(("mistake", "has_trace"), [("raises", True), ("returns nothing", False)])
def test_a_trace_is_logged_where_it_has_lines_of_the_controller(
    mistake: str, has_trace: bool, caplog: pytest.LogCaptureFixture
) -> None:
    methods, text = GOES_WRONG[mistake]
    fly(flown(wrong(**methods)))
    (failed,) = [record for record in caplog.records if "'stranger' failed" in record.getMessage()]
    assert text in failed.getMessage()
    assert (failed.exc_info is not None) == has_trace
