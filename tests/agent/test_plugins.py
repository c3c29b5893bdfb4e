"""Controllers of strangers that go wrong: refused before take-off, or the loss of their own UAVs and of no others."""

from collections.abc import Iterator, Sequence
from typing import Any, ClassVar

import numpy as np
import pytest

from meanflock.agent.controllers.base import Broadcast, Controller, Memory, Received, Step
from meanflock.groundstation import engine as engines
from meanflock.groundstation.engine import Engine
from meanflock.swarm import plugins
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.wire.messages import Status, Telemetry
from meanflock.worldsim.checkpoint import Resumption

BAD, WHEN = 2, 7  # the UAV whose controller goes wrong, and the tick it does in
UAVS = 5


class Honest(Controller):
    """Flies to the destination, learns a number, and says where it is; the base of all that go wrong."""

    name: ClassVar[str] = "stranger"
    parameters = 2
    weights = 3
    diagnostics = ("speed",)
    period_ticks = 5

    def init(self, uavs: np.ndarray, plan: np.ndarray) -> Memory:
        return {"uav": uavs.astype(np.int32), "model": np.zeros((len(uavs), 2)), "ticks": np.zeros(len(uavs), np.int64)}

    def step(self, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        push = -0.02 * own[:, :2] - 0.3 * own[:, 2:] + 0.01 * memory["model"]
        for frames in received:
            np.add.at(push, frames.links[:, 1], 1e-6 * frames.payload[frames.links[:, 0], :2])
        after = memory | {"ticks": memory["ticks"] + 1, "model": memory["model"] + 1e-3 * own[:, :2]}
        return Step(after, push, np.abs(own[:, 2:]).sum(axis=1, keepdims=True), (Broadcast(own),))

    def get(self, memory: Memory) -> np.ndarray:
        return memory["model"]

    def set(self, memory: Memory, rows: np.ndarray, models: np.ndarray) -> Memory:
        model = memory["model"].copy()
        model[rows] = models
        return memory | {"model": model}

    def report(self, memory: Memory) -> np.ndarray:
        return np.concatenate([memory["model"], memory["ticks"][:, None]], axis=1)

    def is_time(self, memory: Memory) -> bool:
        return bool(((memory["uav"] == BAD) & (memory["ticks"] >= WHEN)).any())


@pytest.fixture(autouse=True)
def _nothing_stays(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(plugins, "_files", dict(plugins._files))
    return


def flown(made: type[Controller], *settings: str) -> Scenario:
    plugins.register(made)
    return load(None, [f"uavs={UAVS}", "duration=3", 'stop="duration"', *settings], method=made.name)


class Blocks:
    """A sink that keeps the telemetry."""

    def __init__(self) -> None:
        self.blocks: list[Telemetry] = []

    def write(self, block: Telemetry) -> None:
        """One block more."""
        self.blocks.append(block)

    @property
    def events(self) -> list[tuple[str, str]]:
        """Kind and text of all events."""
        return [(event.kind, event.text) for block in self.blocks for event in block.events]


def fly(of: Scenario, rows: int | None = None, **more: Any) -> tuple[dict[str, Any], Blocks]:
    sink = Blocks()
    engine = Engine(of, "strangers", uavs_per_node=rows, sinks=[sink], **more)
    for _ in engine.fly():
        pass
    return engine.world.finish(), sink


def wrong(**methods: Any) -> type[Controller]:
    return type("Wrong", (Honest,), methods)


# -- in mid-flight ------------------------------------------------------------------------------------------------


def raises(self: Honest, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
    if self.is_time(memory):
        raise ZeroDivisionError("nothing to divide by")
    return Honest.step(self, memory, tick, own, received)


def changed(**fields: Any) -> Any:
    """A step in which something is not as it must be, of the bad UAV from some tick on."""

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


def fails(*_: Any) -> Any:
    raise KeyError("weights")


def leaves(self: Honest, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
    if self.is_time(memory):
        raise SystemExit(3)
    return Honest.step(self, memory, tick, own, received)


GOES_WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "raises": ({"step": raises}, "ZeroDivisionError: nothing to divide by"),
    "calls it a day": ({"step": leaves}, "SystemExit: 3 (test_plugins.py, line"),
    "returns nothing": ({"step": returns("step", lambda _: None)}, "`step` returns a NoneType; expected mf.Step("),
    "returns an acceleration": ({"step": returns("step", lambda good: good.acceleration)}, "`step` returns a ndarray"),
    "an acceleration of three axes": (
        {"step": changed(acceleration=lambda good, bad: np.zeros((len(bad), 3)))},
        "acceleration has shape",
    ),
    "too few diagnostics": ({"step": changed(diagnostics=lambda good, bad: np.zeros((len(bad), 0)))}, "Error"),
    "no diagnostics": ({"step": changed(diagnostics=lambda good, bad: None)}, "Error"),
    "a memory without an array": ({"step": changed(memory=lambda good, bad: {"uav": good.memory["uav"]})}, "memory"),
    "a memory that changes its type": (
        {"step": changed(memory=lambda good, bad: good.memory | {"ticks": good.memory["ticks"] * 1.0})},
        "memory['ticks']",
    ),
    "a broadcast of nothing": (
        {"step": changed(broadcasts=lambda good, bad: (Broadcast(np.zeros((len(bad), 0))),))},
        "0)",
    ),
    "a broadcast too wide": (
        {"step": changed(broadcasts=lambda good, bad: (Broadcast(np.zeros((len(bad), 5000))),))},
        "5000",
    ),
    "too many broadcasts": ({"step": changed(broadcasts=lambda good, bad: good.broadcasts * 17)}, "17 broadcasts"),
    "a broadcast of rows that are not there": (
        {"step": changed(broadcasts=lambda good, bad: (Broadcast(np.zeros((1, 4)), np.array([len(bad)])),))},
        "ascending",
    ),
    "a broadcast of texts": (
        {"step": changed(broadcasts=lambda good, bad: (Broadcast(np.full((len(bad), 1), "x")),))},
        "a broadcast of",
    ),
    "a broadcast of lists": (
        {"step": changed(broadcasts=lambda good, bad: (Broadcast([[1.0]] * len(bad)),))},  # type: ignore[arg-type]
        "a broadcast of a list; expected an array",
    ),
    "a broadcast that is none": (
        {"step": changed(broadcasts=lambda good, bad: (np.zeros((len(bad), 4)),))},
        "mf.Broadcast",
    ),
    "a broadcast alone": ({"step": changed(broadcasts=lambda good, bad: good.broadcasts[0])}, "of mf.Broadcast"),
    "refuses who is not there": (
        {"step": changed(refused=lambda good, bad: np.array([0, UAVS]))},
        "`refused` names UAVs from 0 to 5; there are 0 … 4",
    ),
    "refuses who cannot be": (
        {"step": changed(refused=lambda good, bad: np.array([-1]))},
        "`refused` names UAVs from -1",
    ),
    "refuses a table": (
        {"step": changed(refused=lambda good, bad: np.zeros((1, 2), int))},
        "no array of numbers of UAVs",
    ),
    "refuses in words": ({"step": changed(refused=lambda good, bad: ["UAV 3"])}, "refused"),
    "an acceleration that is no number": (
        {"step": changed(acceleration=lambda good, bad: spoiled(good.acceleration, bad, np.nan))},
        "its acceleration along x is nan",
    ),
    "an acceleration without end": (
        {"step": changed(acceleration=lambda good, bad: spoiled(good.acceleration, bad, np.inf))},
        "its acceleration along x is inf",
    ),
    "a diagnostic that is no number": (
        {"step": changed(diagnostics=lambda good, bad: spoiled(good.diagnostics, bad, np.nan))},
        "its speed is nan",
    ),
    "get raises": ({"get": returns("get", fails)}, "KeyError: 'weights'"),
    "get of another shape": ({"get": returns("get", lambda good: good[:, :1])}, "`get` returns shape"),
    "get that is no number": ({"get": returns("get", lambda good: good * np.nan)}, "not finite"),
    "set raises": ({"set": returns("set", fails)}, "KeyError: 'weights'"),
    "set of another shape": (
        {"set": returns("set", lambda good: good | {"model": good["model"][:, :1]})},
        "memory['model']",
    ),
    "report raises": ({"report": returns("report", fails)}, "KeyError: 'weights'"),
    "report of another shape": ({"report": returns("report", lambda good: good[:, :1])}, "`report` returns shape"),
    "report that is no number": ({"report": returns("report", lambda good: good + np.inf)}, "not finite"),
}
QUIET = ["radio.target_snr_db=60"]  # nothing is lost on the way


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
        lost = [said for kind, said in sink.events if kind == "diverged"]
        assert len(lost) == 1
        assert f"UAV {BAD}" in lost[0]
        named = [said for kind, said in sink.events if "failed with UAV" in said]
        assert len(named) == 1
        assert all(f"UAV {BAD}: " in said and text in said for said in named)
    assert together[0]["trajectory_sha256"] == alone[0]["trajectory_sha256"]
    for one, other in zip(together[1].blocks, alone[1].blocks, strict=True):
        np.testing.assert_array_equal(one.diagnostics, other.diagnostics)


@pytest.mark.parametrize("kind", [np.float32, np.int64, list])
def test_accelerations_of_any_number_do_where_no_diagnostics_are_declared(kind: Any) -> None:
    def step(self: Honest, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        push = np.round(-0.05 * own[:, :2])
        return Step(memory, push.tolist() if kind is list else push.astype(kind))

    assert fly(flown(wrong(diagnostics=(), step=step)))[0]["lost"] == 0


def test_who_refuses_itself_is_not_lost_for_it_and_who_writes_to_what_init_is_given_harms_nobody() -> None:
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


def test_a_memory_that_no_checkpoint_can_keep_costs_its_own_uav_and_not_the_checkpoint(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
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
        (named,) = [said for kind, said in sink.events if "failed with UAV" in said]
        assert f"UAV {BAD}: ValueError: memory['aside'] has numbers that are not finite" in named
        assert sum(bool(block.checkpoint) for block in sink.blocks) >= 2
    assert len(hashes) == 1


def test_the_others_fly_as_if_it_had_been_lost_for_another_reason() -> None:
    hashes = {
        fly(flown(wrong(**GOES_WRONG[what][0]), "federation.fraction=1.0"))[0]["trajectory_sha256"]
        for what in ("raises", "returns nothing", "a memory without an array", "an acceleration that is no number")
    }
    assert len(hashes) == 1


def test_one_that_fails_for_all_its_rows_together_and_for_none_alone_loses_nobody() -> None:
    def in_company(self: Honest, memory: Memory, tick: int, own: np.ndarray, received: Sequence[Received]) -> Step:
        if len(own) > 1:
            raise RuntimeError("too many")
        return Honest.step(self, memory, tick, own, received)

    strange, honest = fly(flown(wrong(step=in_company))), fly(flown(Honest))
    assert strange[0]["trajectory_sha256"] == honest[0]["trajectory_sha256"]
    assert strange[0]["lost"] == 0


# -- before take-off ----------------------------------------------------------------------------------------------


def explodes(*_: Any) -> Any:
    raise OSError("no such table")


def leaves_at_once(*_: Any) -> Any:
    raise SystemExit(3)


def fails_with_two(self: Honest, uavs: np.ndarray, plan: np.ndarray) -> Memory:
    if (uavs % 2).any():
        raise ValueError("an odd one")
    return Honest.init(self, uavs, plan)


BEGINS_WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "raises in init": ({"init": explodes}, r"failed in `init` with UAV 0: OSError: no such table"),
    "calls it a day": ({"init": leaves_at_once}, r"failed in `init` with UAV 0: SystemExit: 3"),
    "raises in the init of two": (
        {"init": fails_with_two},
        r"`init` with UAV 1, 3: ValueError: .* \(test_plugins.py, line",
    ),
    "names what it remembers by number": (
        {"init": lambda self, *of: Honest.init(self, *of) | {1: of[0]}},
        r"memory\[1\]: its name must be a text",
    ),
    "raises when it is made": (
        {"__init__": explodes},
        r"be made: OSError: no such table \(test_plugins.py, line",
    ),
    "remembers no dict": ({"init": lambda *_: [1, 2]}, r"the memory is a list"),
    "remembers other rows": ({"init": lambda *_: {"model": np.zeros((3, 2))}}, r"a leading axis of 5 rows"),
    "remembers what cannot be kept": ({"init": lambda *_: {"model": np.zeros((5, 2), "c16")}}, r"no array of numbers"),
    "remembers what no checkpoint knows": ({"init": lambda *_: {"n": np.zeros(5, np.uint64)}}, r"no array of numbers"),
    "remembers texts": ({"init": lambda *_: {"model": np.array(["x"] * 5)}}, r"no array of numbers"),
    "declares no number": ({"parameters": "two"}, r"`parameters` is 'two'; expected 0"),
    "declares a truth": ({"parameters": True}, r"`parameters` is True"),
    "declares less than nothing": ({"parameters": -1}, r"`parameters` is -1"),
    "declares too much": ({"parameters": 10**9}, r"`parameters` is 1000000000; expected 0 … 1000000"),
    "declares parts that do not add up": ({"parts": (1, 2)}, r"`parts` \(1, 2\) do not add up to its 2"),
    "declares no parts": ({"parts": 3}, r"a declaration cannot be read"),
    "declares weights without end": ({"weights": 10**9}, r"`weights`"),
    "declares no period": ({"period_ticks": 0}, r"`period_ticks` is 0"),
    "declares a text of diagnostics": ({"diagnostics": "speed"}, r"is a text; write \('speed',\)"),
    "declares a diagnostic twice": ({"diagnostics": ("a", "a")}, r"different names"),
    "declares a diagnostic nobody can write": ({"diagnostics": ("a b",)}, r"different names"),
    "has a model of another size": (
        {"get": lambda _, memory: memory["model"][:, :1]},
        r"`get` returns shape \(1, 1\); "
        r"expected \(1, 2\)",
    ),
    "has no model": ({"get": Controller.get}, r"declares `parameters` must override `get`"),
    "takes no model": ({"set": Controller.set}, r"declares `parameters` must override `set`"),
    "fails to declare": ({"parameters": property(explodes)}, r"a declaration cannot be read: OSError"),
}


@pytest.mark.parametrize("what", BEGINS_WRONG)
def test_a_controller_that_cannot_begin_is_bad_input_of_one_line(what: str) -> None:
    attributes, text = BEGINS_WRONG[what]
    with pytest.raises(BadInput, match=text) as caught:
        Engine(flown(wrong(**attributes)), "strangers")
    assert "'stranger'" in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


# -- what it remembers --------------------------------------------------------------------------------------------


def checkpointed(of: Scenario) -> tuple[dict[str, Any], Resumption]:
    """The summary of a flight, and its last checkpoint with the states up to it."""
    summary, sink = fly(of)
    last = max(k for k, block in enumerate(sink.blocks) if block.checkpoint)
    history = np.concatenate([block.states for block in sink.blocks[: last + 1]])
    return summary, Resumption.of(sink.blocks[last].checkpoint, history)


def test_a_resumed_flight_is_the_undisturbed_one_in_one_process_and_in_many() -> None:
    of = flown(Honest, "duration=110")
    summary, past = checkpointed(of)
    assert past.tick > 100
    for rows in (None, 1, 2):
        resumed, _ = fly(of, rows=rows, resume=past)
        assert resumed["trajectory_sha256"] == summary["trajectory_sha256"]
        assert resumed["diagnostics_max"] == summary["diagnostics_max"]


def test_a_checkpoint_of_another_version_of_the_plugin_is_refused_by_name() -> None:
    _, past = checkpointed(of := flown(Honest, "duration=110"))
    plugin, made = plugins._files["controller", "stranger"]
    plugins._files["controller", "stranger"] = plugin._replace(fingerprint="sha256 of another file"), made
    with pytest.raises(BadInput, match=r"controller 'stranger' of this process; here it is of sha256 of another"):
        Engine(of, "strangers", resume=past)


def test_a_checkpoint_whose_arrays_are_not_those_of_the_plugin_is_refused_with_the_uavs() -> None:
    _, past = checkpointed(flown(Honest, "duration=110"))
    other = wrong(init=lambda self, uavs, plan: Honest.init(self, uavs, plan) | {"more": np.zeros(len(uavs))})
    with pytest.raises(BadInput, match=r"UAV 0, 1, 2, 3, 4 .* does not fit this controller: .*'more'"):
        Engine(flown(other, "duration=110"), "strangers", resume=past)


def test_a_memory_too_large_for_a_checkpoint_is_not_kept_and_the_flight_goes_on() -> None:
    large = wrong(
        init=lambda self, uavs, plan: Honest.init(self, uavs, plan) | {"map": np.zeros((len(uavs), 1_000_000))}
    )
    for rows in (None, 1):
        summary, sink = fly(flown(large, "duration=1"), rows=rows)
        assert not any(block.checkpoint for block in sink.blocks)
        assert (summary["ticks"], summary["lost"], summary["dropped_messages"]) == (10, 0, {})
