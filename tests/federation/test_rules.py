"""Aggregation rules of strangers: what they remember goes on with the run, and one that fails makes its round void."""

from typing import Any, ClassVar

import numpy as np
import pytest

from meanflock.federation.rules.base import Aggregator, State
from meanflock.federation.rules.fedavg import mean
from meanflock.groundstation.launch.engine import Engine
from meanflock.swarm import plugins
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario, load
from meanflock.worldsim.checkpoint import Resumption
from tests.telemetry import fly

FLOATS = 108


class Momentum(Aggregator):
    """The mean, moved on by half of how it moved last time."""

    name: ClassVar[str] = "momentum"

    def init(self, parameters: int) -> State:
        return {"last": np.zeros(parameters), "moved": np.zeros(parameters)}

    def step(self, state: State, models: np.ndarray, uavs: np.ndarray, round_: int) -> tuple[State, np.ndarray]:
        moved = mean(models) - state["last"] + 0.5 * state["moved"]
        last = state["last"] + moved
        return {"last": last, "moved": moved}, last


def flown(made: type[Aggregator], *settings: str) -> Scenario:
    plugins.register(made)
    fixed = ["uavs=4", "federation.period=10", f"federation.aggregation={made.name}", 'stop="duration"']
    return load(None, [*fixed, "duration=6", *settings], method="mfgfl-h")


def wrong(**methods: Any) -> type[Aggregator]:
    return type("Wrong", (Momentum,), methods)


# -- what it remembers --------------------------------------------------------------------------------------------


def test_what_a_rule_remembers_makes_a_difference() -> None:
    assert (
        fly(flown(Momentum))[0]["trajectory_sha256"]
        != fly(flown(wrong(init=Momentum.init, step=forgetful)))[0]["trajectory_sha256"]
    )


def forgetful(self: Momentum, state: State, models: np.ndarray, uavs: np.ndarray, round_: int) -> tuple[State, Any]:
    return state, Momentum.step(self, state, models, uavs, round_)[1]


def test_a_resumed_flight_averages_as_the_undisturbed_one() -> None:
    of = flown(Momentum, "duration=110")
    summary, sink = fly(of)
    last = max(k for k, block in enumerate(sink.blocks) if block.checkpoint)
    past = Resumption.decode(sink.blocks[last].checkpoint, np.concatenate([b.states for b in sink.blocks[: last + 1]]))
    assert past.tick > 100
    resumed, _ = fly(of, resume=past)
    assert resumed["rounds"] == summary["rounds"] > 100
    assert resumed["trajectory_sha256"] == summary["trajectory_sha256"]


@pytest.mark.parametrize("tick", [15, 31, 32, 45])
def test_a_standby_that_takes_over_averages_on_as_the_leader_would_have(tick: int) -> None:
    calm, _ = fly(flown(Momentum))
    script = f"faults=[{{kind='leader-loss', tick={tick}}}]"
    plugins.register(Momentum)
    lost = load(None, ["uavs=4", "federation.period=10", "federation.aggregation=momentum", 'stop="duration"',
                       "duration=6", script], method="mfgfl-h")  # fmt: skip
    summary, sink = fly(lost)
    assert any("takes over" in text for text in sink.texts)
    assert summary["rounds"] == calm["rounds"]
    assert summary["trajectory_sha256"] == calm["trajectory_sha256"]


# -- what goes wrong ----------------------------------------------------------------------------------------------


def explodes(*_: Any) -> Any:
    raise OSError("no such table")


def leaves(*_: Any) -> Any:
    raise SystemExit(3)


def in_round_two(spoil: Any) -> Any:
    def step(self: Momentum, state: State, models: np.ndarray, uavs: np.ndarray, round_: int) -> Any:
        good = Momentum.step(self, state, models, uavs, round_)
        return spoil(*good) if round_ == 2 else good

    return step


GOES_WRONG = {
    "raises": (explodes, "OSError: no such table"),
    "calls it a day": (leaves, "SystemExit: 3 (test_rules.py, line"),
    "returns nothing": (lambda state, model: None, "`step` returns a NoneType; expected the state and the model"),
    "a state named by number": (
        lambda state, model: ({1: model}, model),
        "state has ['1']; of `init` it had ['last', 'moved']",
    ),
    "a state that grows": (lambda state, model: (state | {"models": model}, model), "state has ['last', 'models',"),
    "a state of other shape": (lambda state, model: (state | {"last": model[:-1]}, model), "(107,) float64; of `init`"),
    "another shape": (lambda state, model: (state, model[:-1]), r"the model has shape (107,); expected (108,)"),
    "no number": (lambda state, model: (state, model * np.nan), "the model is not finite"),
    "a state that is no dict": (lambda state, model: ([1], model), "state is a list; expected a dict of arrays"),
    "complex numbers": (lambda state, model: (state, model * 1j), "Cannot cast array data from dtype('complex128')"),
    "a state without an axis": (
        lambda state, model: (state | {"last": np.float64(1)}, model),
        "is () float64; of `init`",
    ),
    "a state of texts": (
        lambda state, model: (state | {"last": np.array(["x"])}, model),
        "state['last'] is (1,) <U1; of `init` it was (108,) float64",
    ),
    "a state that is no number": (
        lambda state, model: (state | {"last": model * np.inf}, model),
        "state['last'] is not finite",
    ),
}


@pytest.mark.parametrize("what", GOES_WRONG)
def test_a_rule_that_fails_makes_its_round_void_and_the_flight_goes_on(what: str) -> None:
    spoil, text = GOES_WRONG[what]
    summary, sink = fly(flown(wrong(step=in_round_two(spoil))))
    assert summary["ticks"] == 60
    assert (summary["lost"], summary["nodes_lost"], summary["dropped_messages"]) == (0, 0, {})
    assert summary["rounds"] == 4  # of five
    (said,) = [said for said in sink.texts if "failed in round" in said]
    assert "aggregator 'momentum' failed in round 2" in said
    assert text in said


def test_a_global_model_no_radio_can_say_is_not_sent_but_what_the_rule_learned_is_kept() -> None:
    def beyond(state: State, model: np.ndarray) -> Any:
        return state, np.full_like(model, 1e300)

    summary, sink = fly(flown(wrong(step=in_round_two(beyond))))
    assert summary["rounds"] == 4
    assert any("beyond what the radio's floats can say" in said for said in sink.texts)


BEGINS_WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "raises in init": ({"init": explodes}, r"aggregator 'momentum' failed in `init`: OSError: no such table"),
    "raises when it is made": ({"__init__": explodes}, r"aggregator 'momentum' cannot be made: OSError: no such table"),
    "begins with no dict": ({"init": lambda *_: 3}, r"failed in `init`: TypeError: state is a int"),
    "begins with too much": (
        {"init": lambda *_: {"last": np.zeros(4_000_000)}},
        r"the state has 32000000 bytes; at mo",
    ),
    "begins with what is no number": ({"init": lambda *_: {"last": np.full(2, np.nan)}}, r"is not finite"),
}


@pytest.mark.parametrize("what", BEGINS_WRONG)
def test_a_rule_that_cannot_begin_is_bad_input_of_one_line(what: str) -> None:
    methods, text = BEGINS_WRONG[what]
    with pytest.raises(BadInput, match=text) as caught:
        Engine(flown(wrong(**methods)), "rules")
    assert len(str(caught.value).splitlines()) == 1
