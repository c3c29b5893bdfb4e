"""Aggregation rules of users: their state goes on with the run, and a rule that fails makes its round void."""

from typing import Any

import numpy as np
import pytest

from meanflock.federation.rules.base import Aggregator, State, Uploads
from meanflock.federation.rules.fedavg import mean
from meanflock.groundstation.launch.engine import Engine
from meanflock.swarm import plugins
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario, load
from tests.federation.momentum import Momentum
from tests.telemetry import fly

FLOATS = 108


def flown(made: type[Aggregator], *settings: str) -> Scenario:
    plugins.register(made)
    fixed = ["uavs=4", "federation.period=10", f"federation.aggregation={made.name}", 'stop="duration"']
    return load(None, [*fixed, "duration=6", *settings], method="mfgfl-h")


def wrong(**methods: Any) -> type[Aggregator]:
    return type("Wrong", (Momentum,), methods)


@pytest.mark.parametrize("tick", [15, 31, 32])
def test_a_standby_that_takes_over_averages_on_as_the_leader_would_have(tick: int) -> None:
    calm, _ = fly(flown(Momentum))
    summary, sink = fly(flown(Momentum, f"faults=[{{kind='leader-loss', tick={tick}}}]"))
    assert any("takes over" in text for text in sink.texts)
    assert summary["rounds"] == calm["rounds"]
    assert summary["trajectory_sha256"] == calm["trajectory_sha256"]


def fails(*_: Any) -> Any:
    raise OSError("no such table")


def exits(*_: Any) -> Any:
    raise SystemExit(3)


def in_round_two(spoil: Any) -> Any:
    def step(self: Momentum, state: State, uploads: Uploads) -> Any:
        good = Momentum.step(self, state, uploads)
        return spoil(*good) if uploads.round == 2 else good

    return step


FAILURES: list[tuple[Any, str]] = [
    (fails, "OSError: no such table"),
    (exits, "SystemExit: 3 (test_rules.py, line"),
    (lambda _state, _model: None, "`step` returns a NoneType; expected the state and the model"),
    (lambda state, model: (state | {"models": model}, model), "state has ['last', 'models',"),
    (lambda state, model: (state | {"last": model[:-1]}, model), "(107,) float64; of `init`"),
    (lambda state, model: (state | {"last": model * np.inf}, model), "state['last'] is not finite"),
    (lambda _state, model: ([1], model), "state is a list; expected a dict of arrays"),
    (lambda state, model: (state, model[:-1]), "the model has shape (107,); expected (108,)"),
    (lambda state, model: (state, model * np.nan), "the model is not finite"),
    (lambda state, model: (state, model * 1j), "Cannot cast array data from dtype('complex128')"),
]


@pytest.mark.parametrize(("spoil", "expected"), FAILURES, ids=[expected for _, expected in FAILURES])
def test_a_rule_that_fails_makes_its_round_void_and_the_flight_goes_on(spoil: Any, expected: str) -> None:
    summary, sink = fly(flown(wrong(step=in_round_two(spoil))))
    assert summary["ticks"] == 60
    assert (summary["lost"], summary["nodes_lost"], summary["dropped_messages"]) == (0, 0, {})
    assert (summary["rounds"], summary["rounds_void"]) == (4, 1)
    assert any("round 2 is void: the aggregation rule failed" in text for text in sink.texts)
    (text,) = [text for text in sink.texts if "failed in round" in text]
    assert "aggregator 'momentum' failed in round 2" in text
    assert expected in text


def test_a_rule_that_waits_for_more_keeps_its_state_and_nothing_is_broadcast() -> None:
    """It averages in every second round: neither a complaint nor a model in the others."""

    def step(_self: Momentum, state: State, uploads: Uploads) -> tuple[State, np.ndarray | None]:
        assert state["last"][0] == uploads.round - 1
        after = state | {"last": np.full_like(state["last"], float(uploads.round))}
        return after, mean(uploads.models) if uploads.round % 2 == 0 else None

    summary, sink = fly(flown(wrong(step=step)))
    assert (summary["rounds"], summary["rounds_void"]) == (2, 0)
    assert sum("the aggregation rule waits for more models" in text for text in sink.texts) == 3
    assert not [text for text in sink.texts if "failed" in text]


def test_a_global_model_beyond_the_radio_s_floats_is_not_sent_but_the_state_is_kept() -> None:
    summary, sink = fly(flown(wrong(step=in_round_two(lambda state, model: (state, np.full_like(model, 1e300))))))
    assert summary["rounds"] == 4
    assert any("beyond what the radio's floats can say" in text for text in sink.texts)


@pytest.mark.parametrize(
    ("methods", "expected"),
    [
        ({"step": lambda _self, _state, _models, _uavs, _round: None}, r"write step\(self, state, uploads\)"),
        ({"init": fails}, r"aggregator 'momentum' failed in `init`: OSError: no such table"),
        ({"__init__": fails}, r"aggregator 'momentum' cannot be made: OSError: no such table"),
        ({"init": lambda *_: 3}, r"failed in `init`: TypeError: state is a int"),
        ({"init": lambda *_: {"last": np.zeros(4_000_000)}}, r"the state has 32000000 bytes; at mo"),
        ({"init": lambda *_: {"last": np.full(2, np.nan)}}, r"is not finite"),
    ],
)
def test_a_rule_that_cannot_begin_is_bad_input_of_one_line(methods: dict[str, Any], expected: str) -> None:
    with pytest.raises(BadInput, match=expected) as caught:
        Engine(flown(wrong(**methods)), "rules")
    assert len(str(caught.value).splitlines()) == 1
