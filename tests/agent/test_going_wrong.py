"""Controllers of strangers that go wrong: before take-off, in flight, or with the checkpoint of another."""

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
import pytest

from meanflock.agent import node
from meanflock.agent.controllers.base import Broadcast, Controller, Memory, Received, Step
from meanflock.groundstation.launch import engine
from meanflock.groundstation.launch.engine import Engine
from meanflock.swarm import plugins
from meanflock.swarm.errors import BadInput
from meanflock.swarm.plugins import registry
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire.messages import Status
from tests.telemetry import fly
from tests.testing.good import GoodController

BAD, WHEN = 2, 7  # the UAV whose controller goes wrong, and the tick it does in
UAVS = 5


class Honest(GoodController):
    """Flies to the destination, learns two numbers, and broadcasts its state; the base of the wrong controllers."""

    name: ClassVar[str] = "stranger"
    parameters = 2
    weights = 3
    diagnostics = ("speed",)
    period_ticks = 5

    def init(self, uavs: np.ndarray, plan: np.ndarray) -> Memory:
        rows = len(uavs)
        memory = {"uav": uavs.astype(np.int32), "model": np.zeros((rows, 2)), "ticks": np.zeros(rows, np.int64)}
        return memory | {"aside": np.ones((rows, 2, 3))}

    def step(self, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        push = -0.02 * own[:, :2] - 0.3 * own[:, 2:] + 0.01 * memory["model"]
        for frames in received:
            np.add.at(push, frames.links[:, 1], 1e-6 * frames.payload[frames.links[:, 0], :2])
        after = memory | {"ticks": memory["ticks"] + 1, "model": memory["model"] + 1e-3 * own[:, :2]}
        return Step(after, push, np.abs(own[:, 2:]).sum(axis=1, keepdims=True), (Broadcast(own),))

    def report(self, memory: Memory) -> np.ndarray:
        return np.concatenate([memory["model"], memory["ticks"][:, None]], axis=1)

    def is_time(self, memory: Memory) -> bool:
        return bool(((memory["uav"] == BAD) & (memory["ticks"] >= WHEN)).any())


def flown(controller: type[Controller], *settings: str) -> Scenario:
    plugins.register(controller)
    return load(None, [f"uavs={UAVS}", "duration=3", 'stop="duration"', *settings], method=controller.name)


def wrong(**methods: Any) -> type[Controller]:
    return type("Wrong", (Honest,), methods)


def changed(**fields: Any) -> Any:
    """A step with other fields, of the bad UAV from some tick on."""

    def step(self: Honest, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        good = Honest.step(self, memory, tick, own, received)
        if not self.is_time(memory):
            return good
        parts = {name: getattr(good, name) for name in good.__struct_fields__}
        return Step(**parts | {name: make(good, memory["uav"] == BAD) for name, make in fields.items()})

    return step


def spoiled(array: np.ndarray, bad: np.ndarray, number: float) -> np.ndarray:
    array = array.copy()
    array[bad] = number
    return array


def returns(name: str, spoil: Any) -> Any:
    def method(self: Honest, memory: Memory, *more: Any) -> Any:
        good = getattr(Honest, name)(self, memory, *more)
        return spoil(good) if self.is_time(memory) else good

    return method


QUIET = ["radio.target_snr_db=60"]  # nothing is lost on the way


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
    "declares too much": ({"parameters": 10**9}, r"`parameters` is 1000000000; expected 0 … 1000000"),
    "declares parts that do not add up": ({"parts": (1, 2)}, r"`parts` \(1, 2\) do not add up to its 2"),
    "declares no parts": ({"parts": 3}, r"a declaration cannot be read"),
    "declares no period": ({"period_ticks": 0}, r"`period_ticks` is 0"),
    "declares a text of diagnostics": ({"diagnostics": "speed"}, r"is a text; write \('speed',\)"),
    "declares a diagnostic twice": ({"diagnostics": ("a", "a")}, r"different names"),
    "has a model of another size": (
        {"get": lambda _, memory: memory["model"][:, :1]},
        r"`get` returns shape \(1, 1\); expected \(1, 2\)",
    ),
    "has no model": ({"get": Controller.get}, r"declares `parameters` must override `get`"),
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


def fails(*_: Any) -> Any:
    raise KeyError("weights")


def said(payload: Any) -> dict[str, Any]:
    """A step with another broadcast; `payload` is a function of the number of rows."""
    return stepping(broadcasts=lambda _, bad: (Broadcast(payload(len(bad))),))


def stepping(**fields: Any) -> dict[str, Any]:
    return {"step": changed(**fields)}


# What goes wrong: the methods of the controller, and a part of the text of the event.
GOES_WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "raises": ({"step": returns("step", lambda _: 1 / 0)}, "ZeroDivisionError: division by zero"),
    "exits": ({"step": returns("step", lambda _: exit(3))}, "SystemExit: 3 (test_going_wrong.py, line"),
    "returns nothing": ({"step": returns("step", lambda _: None)}, "`step` returns a NoneType; expected mf.Step("),
    "an acceleration that is no number": (
        stepping(acceleration=lambda good, bad: spoiled(good.acceleration, bad, np.nan)),
        "its acceleration along x is nan",
    ),
    "no diagnostics": (stepping(diagnostics=lambda *_: None), "no diagnostics"),
    "an infinite diagnostic": (
        stepping(diagnostics=lambda good, bad: spoiled(good.diagnostics, bad, np.inf)),
        "its speed is inf",
    ),
    "a memory without an array": (stepping(memory=lambda good, _: {"uav": good.memory["uav"]}), "memory"),
    "a memory that is not finite": (
        stepping(memory=lambda good, bad: good.memory | {"aside": spoiled(good.memory["aside"], bad, np.nan)}),
        "ValueError: memory['aside'] has numbers that are not finite",
    ),
    "a broadcast of nothing": (said(lambda rows: np.zeros((rows, 0))), "0)"),
    "a broadcast too wide": (said(lambda rows: np.zeros((rows, 5000))), "5000"),
    "a broadcast of texts": (said(lambda rows: np.full((rows, 1), "x")), "a broadcast of"),
    "a broadcast of lists": (said(lambda rows: [[1.0]] * rows), "a broadcast of a list"),
    "too many broadcasts": (stepping(broadcasts=lambda good, _: good.broadcasts * 17), "17 broadcasts"),
    "no tuple of broadcasts": (stepping(broadcasts=lambda good, _: good.broadcasts[0]), "of mf.Broadcast"),
    "refuses a UAV beyond the last": (stepping(refused=lambda *_: np.array([0, UAVS])), "`refused` names UAVs from 0"),
    "refuses a table": (stepping(refused=lambda *_: np.zeros((1, 2), int)), "no array of numbers of UAVs"),
    "get raises": ({"get": returns("get", fails)}, "KeyError: 'weights'"),
    "get of another shape": ({"get": returns("get", lambda good: good[:, :1])}, "result of `get` has shape"),
    "set raises": ({"set": returns("set", fails)}, "KeyError: 'weights'"),
    "report that is no number": ({"report": returns("report", lambda good: good + np.inf)}, "not finite"),
}


@pytest.mark.parametrize("mistake", GOES_WRONG)
def test_a_controller_that_goes_wrong_costs_its_own_uav_in_one_process_as_in_many(mistake: str) -> None:
    methods, text = GOES_WRONG[mistake]
    of = flown(wrong(**methods), "federation.fraction=1.0", *QUIET)
    together, alone = fly(of), fly(of, rows=1)
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


def test_a_uav_that_refuses_itself_is_not_lost_and_writing_to_the_numbers_of_init_does_no_harm() -> None:
    def init(self: Honest, uavs: np.ndarray, plan: np.ndarray) -> Memory:
        memory = Honest.init(self, uavs, plan)
        uavs += 1
        return memory

    def step(self: Honest, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        good = Honest.step(self, memory, tick, own, received)
        return Step(good.memory, good.acceleration, good.diagnostics, good.broadcasts, memory["uav"])

    hashes = set()
    for rows in (None, 1):
        summary, _ = fly(flown(wrong(init=init, step=step), *QUIET), rows)
        assert (summary["lost"], summary["nodes_lost"], summary["dropped_messages"]) == (0, 0, {})
        hashes.add(summary["trajectory_sha256"])
    assert hashes == {fly(flown(Honest, *QUIET))[0]["trajectory_sha256"]}


def test_a_controller_that_fails_for_all_rows_together_and_for_none_alone_loses_no_uav() -> None:
    def in_company(self: Honest, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        if len(own) > 1:
            raise RuntimeError("too many")
        return Honest.step(self, memory, tick, own, received)

    strange, honest = fly(flown(wrong(step=in_company))), fly(flown(Honest))
    assert strange[0]["trajectory_sha256"] == honest[0]["trajectory_sha256"]
    assert strange[0]["lost"] == 0


@pytest.fixture(autouse=True)
def _often(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine, "_checkpoint_every", lambda *_: 10)


def test_a_checkpoint_of_another_version_of_the_plugin_is_refused_by_name() -> None:
    of = flown(Honest, "duration=3")
    past = fly(of)[1].checkpoints[-1]
    plugin, controller = registry.registered["controller", "stranger"]
    registry.registered["controller", "stranger"] = plugin._replace(fingerprint="sha256 of another file"), controller
    with pytest.raises(BadInput, match=r"controller 'stranger' of this process; here it is of sha256 of another"):
        Engine(of, "strangers", resume=past)


def test_a_checkpoint_whose_arrays_are_not_those_of_the_plugin_is_refused_with_the_uavs() -> None:
    past = fly(flown(Honest, "duration=3"))[1].checkpoints[-1]
    other = wrong(init=lambda self, uavs, plan: Honest.init(self, uavs, plan) | {"more": np.zeros(len(uavs))})
    with pytest.raises(BadInput, match=r"UAV 0, 1, 2, 3, 4.* does not fit this controller: .*'more'"):
        Engine(flown(other, "duration=3"), "strangers", resume=past)


def test_a_memory_too_large_for_a_checkpoint_is_not_stored_and_the_flight_goes_on(monkeypatch) -> None:
    monkeypatch.setattr(node, "MAX_MEMORY_BYTES", 2**20)
    large = wrong(init=lambda self, uavs, plan: Honest.init(self, uavs, plan) | {"map": np.zeros((len(uavs), 100_000))})
    for rows in (None, 1):
        summary, sink = fly(flown(large, "duration=1"), rows=rows)
        assert not any(block.checkpoint for block in sink.blocks)
        assert (summary["ticks"], summary["lost"], summary["dropped_messages"]) == (10, 0, {})
