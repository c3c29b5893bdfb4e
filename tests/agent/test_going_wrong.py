"""A controller that goes wrong in flight is the loss of its own UAVs and of no others."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from meanflock.agent.controllers.base import Broadcast, Memory, Received, Step
from meanflock.groundstation.launch import engine as engines
from meanflock.swarm.wire.messages import Status
from tests.agent.strangers import BAD, QUIET, UAVS, Honest, changed, flown, returns, spoiled, wrong
from tests.telemetry import fly


def raises(self: Honest, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
    if self.is_time(memory):
        raise ZeroDivisionError("nothing to divide by")
    return Honest.step(self, memory, tick, own, received)


def fails(*_: Any) -> Any:
    raise KeyError("weights")


def leaves(self: Honest, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
    if self.is_time(memory):
        raise SystemExit(3)
    return Honest.step(self, memory, tick, own, received)


def said(payload: Any, rows: Any = None) -> dict[str, Any]:
    """A step with another broadcast; `payload` and `rows` are functions of the number of rows."""
    return stepping(broadcasts=lambda _, bad: (Broadcast(payload(len(bad)), None if rows is None else rows(len(bad))),))


def stepping(**fields: Any) -> dict[str, Any]:
    return {"step": changed(**fields)}


# What goes wrong: the methods of the controller, and a part of the text of the event.
GOES_WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "raises": ({"step": raises}, "ZeroDivisionError: nothing to divide by"),
    "exits": ({"step": leaves}, "SystemExit: 3 (test_going_wrong.py, line"),
    "returns nothing": ({"step": returns("step", lambda _: None)}, "`step` returns a NoneType; expected mf.Step("),
    "an acceleration of three axes": (
        stepping(acceleration=lambda _, bad: np.zeros((len(bad), 3))),
        "acceleration has shape",
    ),
    "complex accelerations": (
        stepping(acceleration=lambda good, bad: good.acceleration + (1j if bad.any() else 0)),
        "Cannot cast array data from dtype('complex128')",
    ),
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
    "a memory that changes its type": (
        stepping(memory=lambda good, _: good.memory | {"ticks": good.memory["ticks"] * 1.0}),
        "memory['ticks']",
    ),
    "a broadcast of nothing": (said(lambda rows: np.zeros((rows, 0))), "0)"),
    "a broadcast too wide": (said(lambda rows: np.zeros((rows, 5000))), "5000"),
    "a broadcast of rows that are not there": (
        said(lambda _: np.zeros((1, 4)), lambda rows: np.array([rows])),
        "ascending",
    ),
    "a broadcast of texts": (said(lambda rows: np.full((rows, 1), "x")), "a broadcast of"),
    "a broadcast of lists": (said(lambda rows: [[1.0]] * rows), "a broadcast of a list"),
    "too many broadcasts": (stepping(broadcasts=lambda good, _: good.broadcasts * 17), "17 broadcasts"),
    "no tuple of broadcasts": (stepping(broadcasts=lambda good, _: good.broadcasts[0]), "of mf.Broadcast"),
    "refuses a UAV beyond the last": (stepping(refused=lambda *_: np.array([0, UAVS])), "`refused` names UAVs from 0"),
    "refuses a table": (stepping(refused=lambda *_: np.zeros((1, 2), int)), "no array of numbers of UAVs"),
    "get raises": ({"get": returns("get", fails)}, "KeyError: 'weights'"),
    "get of another shape": ({"get": returns("get", lambda good: good[:, :1])}, "result of `get` has shape"),
    "set raises": ({"set": returns("set", fails)}, "KeyError: 'weights'"),
    "set of another shape": (
        {"set": returns("set", lambda good: good | {"model": good["model"][:, :1]})},
        "memory['model']",
    ),
    "report that is no number": ({"report": returns("report", lambda good: good + np.inf)}, "not finite"),
}


@pytest.mark.parametrize("what", GOES_WRONG)
def test_a_controller_that_goes_wrong_costs_its_own_uav_in_one_process_as_in_many(what: str) -> None:
    methods, text = GOES_WRONG[what]
    of = flown(wrong(**methods), "federation.fraction=1.0", *QUIET)
    together, alone = fly(of), fly(of, rows=1)
    for summary, sink in (together, alone):
        assert summary["ticks"] == 30
        assert summary["dropped_messages"] == {}
        assert summary["nodes_lost"] == 0
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


@pytest.mark.parametrize("kind", [np.float32, np.int64, list])
def test_accelerations_may_be_numbers_of_any_type(kind: Any) -> None:
    def step(self: Honest, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        push = np.round(-0.05 * own[:, :2])
        return Step(memory, push.tolist() if kind is list else push.astype(kind))

    assert fly(flown(wrong(diagnostics=(), step=step)))[0]["lost"] == 0


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


def test_a_memory_that_is_not_finite_costs_its_own_uav_and_not_the_checkpoint(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engines, "_checkpoint_every", lambda *_: 10)

    def init(self: Honest, uavs: np.ndarray, plan: np.ndarray) -> Memory:
        return Honest.init(self, uavs, plan) | {"aside": np.ones((len(uavs), 2, 3))}

    forgets = changed(memory=lambda good, bad: good.memory | {"aside": spoiled(good.memory["aside"], bad, np.nan)})
    of = flown(wrong(init=init, step=forgets), *QUIET)
    hashes = set()
    for rows in (None, 1):
        summary, sink = fly(of, rows)
        hashes.add(summary["trajectory_sha256"])
        assert summary["dropped_messages"] == {}
        assert (sink.blocks[-1].status[-1] == Status.LOST).tolist() == [uav == BAD for uav in range(UAVS)]
        (named,) = [line for line in sink.texts if "failed with UAV" in line]
        assert f"UAV {BAD}: ValueError: memory['aside'] has numbers that are not finite" in named
        assert sum(bool(block.checkpoint) for block in sink.blocks) >= 2
    assert len(hashes) == 1


def test_a_controller_that_fails_for_all_rows_together_and_for_none_alone_loses_no_uav() -> None:
    def in_company(self: Honest, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        if len(own) > 1:
            raise RuntimeError("too many")
        return Honest.step(self, memory, tick, own, received)

    strange, honest = fly(flown(wrong(step=in_company))), fly(flown(Honest))
    assert strange[0]["trajectory_sha256"] == honest[0]["trajectory_sha256"]
    assert strange[0]["lost"] == 0
