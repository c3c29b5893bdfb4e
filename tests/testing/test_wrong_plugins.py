"""Each suite rejects each kind of mistake and names it; so does a flight, of channels, vehicles and codings."""

import re
from typing import Any

import msgspec
import numpy as np
import pytest

from meanflock.agent.controllers.base import Broadcast
from meanflock.launch.engine import Engine
from meanflock.swarm import plugins
from meanflock.swarm.errors import BadInput, RunFailed
from meanflock.swarm.scenario import load
from meanflock.swarm.stateful import restore, state_of
from meanflock.testing import ConformanceError
from tests.memory_swarm import MemorySwarm
from tests.telemetry import Record
from tests.testing.good import (
    KINDS,
    GoodAggregator,
    GoodChannel,
    GoodCoding,
    GoodController,
    GoodFilter,
    GoodVehicle,
    calls,
    changed,
    failing,
    having,
    writing,
)

# -- controllers: a step with another field, which is a function of the good step and of the states ------------------


def step(**fields: Any) -> Any:
    def change(_self: Any, good: Any, memory: Any, _tick: int, own: Any, _received: Any) -> Any:
        return msgspec.structs.replace(good, **{name: make(good, memory, own) for name, make in fields.items()})

    return changed(GoodController, "step", change)


def sets_every_row(_self: Any, _after: Any, memory: Any, _rows: Any, models: Any) -> Any:
    return memory | {"model": np.repeat(models[:1], len(memory["model"]), axis=0)}


def placed(numbers: Any, rows: Any, others: Any) -> Any:
    after = numbers.copy()
    after[rows] = others
    return after


def guided(guide: Any) -> Any:
    """A controller whose goals are in `heard`."""
    return having(GoodController, guided=True, guide=guide)


def writes_goals(_self: Any, memory: Any, rows: Any, goals: Any) -> Any:
    memory["heard"][rows] = goals[:, 0]
    return memory


ERROR = KeyError("weights")
COPY = "writes to an array it was given"
CONTROLLERS: dict[str, tuple[Any, str]] = {
    "an infinite broadcast": (
        step(broadcasts=lambda _, __, own: [Broadcast(np.full_like(own, np.inf))]),
        "such a frame is not sent",
    ),
    "a memory of NaNs": (step(memory=lambda good, _, own: good.memory | {"heard": own[:, 0] * np.nan}), "'heard'"),
    "a command of NaNs": (
        step(acceleration=lambda good, *_: good.acceleration * np.nan),
        "`step`: a command or diagnostic is not finite",
    ),
    "a command beyond all bounds": (
        step(acceleration=lambda good, *_: good.acceleration * 0 + 2e31),
        r"`step`: a command or diagnostic has 2e\+31",
    ),
    "a broadcast beyond the radio's floats": (
        step(broadcasts=lambda _, __, own: [Broadcast(np.full_like(own, 1e39))]),
        "broadcast 0 has a number .* as a float of the radio; such a frame is not sent",
    ),
    "a model of NaNs": (
        changed(GoodController, "get", lambda _, models, *__: models * np.nan),
        "result of `get` is not finite",
    ),
    "a model beyond all bounds": (
        changed(GoodController, "get", lambda _, models, *__: models * 0 - 1e39),
        r"result of `get` has -1e\+39; expected numbers within ±1e\+30",
    ),
    "a report beyond all bounds": (
        changed(GoodController, "report", lambda _, models, *__: models * 0 + 1e31),
        r"result of `report` has 1e\+31",
    ),
    "a weight too small for float32": (
        having(GoodController, weighted=True, samples=lambda _, memory: np.full(len(memory["uav"]), np.exp(-110))),
        "result of `samples` has 1.68891e-48; a weight is sent as float32",
    ),
    "a weight too large for a mean": (
        having(GoodController, weighted=True, samples=lambda _, memory: np.full(len(memory["uav"]), 5e34)),
        r"result of `samples` has 5e\+34; a weight is sent as float32",
    ),
    "weights of another shape": (
        having(GoodController, weighted=True, samples=lambda _, memory: np.ones((len(memory["uav"]), 1))),
        r"`samples` returns shape \(6, 1\), expected \(6,\); return one number a UAV",
    ),
    "broadcasts of two widths": (
        step(broadcasts=lambda _, memory, own: [Broadcast(own[:, : 1 + int(memory["uav"].sum() > 3)])]),
        "broadcast 0 is 1 × float64 and 2 × float64, depending on the UAV",
    ),
    "another row": (step(acceleration=lambda good, _, own: good.acceleration + own[:, :2].sum(axis=0)), "than alone"),
    "three axes": (step(acceleration=lambda _, __, own: own[:, :3]), "acceleration has shape"),
    "needs a frame": (changed(GoodController, "step", lambda *given: given[-1][0] and given[1]), "IndexError"),
    "the name of a column": (having(GoodController, diagnostics=("arrived",)), "has columns of that name"),
    "writes to states": (writing(GoodController, "step", 2), COPY),
    "writes to the memory": (writing(GoodController, "step", 0, "heard"), COPY),
    "writes to the plan": (writing(GoodController, "init", 1), f"`init` {COPY}"),
    "writes to models": (writing(GoodController, "set", 2), f"`set` {COPY}"),
    "fails in get": (failing(GoodController, "get", ERROR), "`get` failed: KeyError: 'weights'"),
    "fails in report": (having(failing(GoodController, "report", ERROR), weights=2), "`report` failed: KeyError"),
    "set returns some rows": (
        having(GoodController, set=lambda _, memory, __, models: memory | {"model": models}),
        r"`set` returns what a flight cannot use: memory\['model'\] is \(4, 3\)",
    ),
    "set changes every row": (changed(GoodController, "set", sets_every_row), "other rows than `rows`"),
    "guided without guide": (having(GoodController, guided=True), "`guide` failed: NotImplementedError: .* override"),
    "guide returns nothing": (guided(lambda *_: None), "`guide`: memory is a NoneType; expected a dict of arrays"),
    "guide returns some rows": (
        guided(lambda _, memory, __, goals: memory | {"heard": goals[:, 0]}),
        r"`guide`: memory\['heard'\] is \(2,\) float64; of `init` it was \(6,\) float64",
    ),
    "guide writes to the memory": (guided(writes_goals), f"`guide` {COPY}"),
    "guide changes every row": (
        guided(lambda _, memory, __, goals: memory | {"heard": memory["heard"] + goals[0, 0]}),
        r"`guide` changes other rows of memory\['heard'\] than `rows`",
    ),
    "guide mixes rows": (
        guided(lambda _, memory, rows, goals: memory | {"heard": placed(memory["heard"], rows, goals.mean())}),
        r"`guide` gives a UAV another memory\['heard'\] with others than alone",
    ),
}

# -- filters, rules, channels and vehicles: another part of the answer -----------------------------------------------


def part(good: type, place: int, change: Any) -> Any:
    """A class whose main method returns another part, `change(part, arguments)`."""

    def replace(_self: Any, answer: Any, *given: Any) -> Any:
        parts = list(answer)
        parts[place] = change(parts[place], *given)
        return tuple(parts)

    return changed(good, next(kind.method for kind in KINDS.values() if kind.good is good), replace)


FILTERS: dict[str, tuple[Any, str]] = {
    "another row": (part(GoodFilter, 0, lambda wanted, own, *_: wanted + own[:, :2].sum(axis=0)), "than alone"),
    "writes to commands": (writing(GoodFilter, "admit", 3), f"`admit` {COPY}"),
    "reports nothing": (part(GoodFilter, 1, lambda said, *_: said[:, :0]), r"\(6, 0\)\), expected .*\(6, 1\)\)"),
    "commands of NaNs": (part(GoodFilter, 0, lambda wanted, *_: wanted * np.nan), "not finite"),
    "makes up a command": (
        part(GoodFilter, 0, lambda wanted, *_: np.nan_to_num(wanted)),
        "a finite command for one that is not",
    ),
    "columns are a text": (having(GoodFilter, columns="apart"), r"`columns` is a text; write \('apart',\)"),
    "admits without commands": (
        having(GoodFilter, admit=lambda self, own, others: None),
        r"`admit` takes \(self, own, others\); write admit\(self, own, others, uavs, wanted\); no flight takes it",
    ),
}
RULES: dict[str, tuple[Any, str]] = {
    "writes to models": (
        changed(GoodAggregator, "step", lambda _, answer, __, given: (given.models.fill(0.0), answer)[1]),
        COPY,
    ),
    "writes to the state": (writing(GoodAggregator, "step", 0, "last"), COPY),
    "a model of another shape": (part(GoodAggregator, 1, lambda model, *_: model[:-1]), r"\(11,\), expected \(12,\)"),
    "a model of NaNs": (part(GoodAggregator, 1, lambda model, *_: model * np.nan), "model is not finite"),
    "a complex model": (part(GoodAggregator, 1, lambda model, *_: model.astype(complex)), "model is complex128"),
    "a model beyond all bounds": (part(GoodAggregator, 1, lambda model, *_: model * 0 + 1e39), r"model has 1e\+39"),
    "needs two models": (part(GoodAggregator, 1, lambda _, __, given: given.models[1]), "1 model failed: IndexError"),
    "weights of another mean": (
        having(GoodAggregator, weights=lambda _, given: np.ones(len(given.models))),
        "`step` is not the mean by `weights`",
    ),
    "fails in init": (failing(GoodAggregator, "init", ERROR), "`init` failed: KeyError"),
    "begins without parameters": (
        having(GoodAggregator, init=lambda self: {}),
        r"`init` takes \(self\); write init\(self, parameters\); no flight takes it",
    ),
    "a state that grows": (
        part(GoodAggregator, 0, lambda state, _, given: {**state, f"round_{given.round}": state["last"]}),
        r"state has \['last', 'round_1'\]; of `init` it had",
    ),
    "an infinite state": (part(GoodAggregator, 0, lambda state, *_: {"last": state["last"] + np.inf}), "not finite"),
    "a state of texts": (having(GoodAggregator, init=lambda *_: {"who": np.array(["me"])}), r"state\['who'\] is <U2"),
}


def fades_slowly(self: Any, answer: Any, *_: Any) -> Any:
    """Remembers the fading of its links, and forgets it when their number changes."""
    slots, delivered = answer
    last = getattr(self, "last", delivered)
    self.last = delivered & last if len(last) == len(slots) else delivered
    return slots, self.last


def depends_on_motion(self: Any, answer: Any, distance_m: Any, *_: Any) -> Any:
    """Remembers the distances, which shows once they change."""
    slots, delivered = answer
    last, self.last = getattr(self, "last", distance_m), distance_m
    return slots + (len(last) == len(slots) and not np.array_equal(last, distance_m)), delivered


class SpawnsGenerators(GoodChannel):
    """The number of generators that were spawned is in no checkpoint."""

    def transmit(self, distance_m: Any, bits: int, rng: np.random.Generator) -> tuple[Any, Any]:
        return super().transmit(distance_m, bits, rng.spawn(1)[0])


REMEMBERS = "continue from a checkpoint differ; keep nothing between two calls"
CHANNELS: dict[str, tuple[Any, str]] = {
    "fades slowly": (changed(GoodChannel, "transmit", fades_slowly), REMEMBERS),
    "depends on motion": (changed(GoodChannel, "transmit", depends_on_motion), REMEMBERS),
    "expects by its past": (changed(GoodChannel, "expected", lambda self, *_: (float(calls(self)), 1.0)), REMEMBERS),
    "spawns generators": (SpawnsGenerators, f"{REMEMBERS}, and of `rng` take numbers only"),
    "writes to distances": (writing(GoodChannel, "transmit", 0), "writes to the distances"),
    "a column of slots": (part(GoodChannel, 0, lambda slots, *_: slots[:, None]), r"int64 \(40, 1\), expected"),
    "messages of no time": (part(GoodChannel, 0, lambda slots, *_: slots - 1), "slots from 0 to"),
    "messages without end": (part(GoodChannel, 0, lambda slots, *_: slots * 1_000_000), "a message takes 1 to 1000000"),
    "expects a NaN": (having(GoodChannel, expected=lambda *_: (np.nan, 1.0)), "expected two finite numbers, or None"),
    "expects one number": (having(GoodChannel, expected=lambda *_: 1.0), "expected two finite numbers, or None"),
    "expects without bits": (
        having(GoodChannel, expected=lambda self, distance_m: None),
        r"`expected` takes \(self, distance_m\); write expected\(self, distance_m, bits\); no flight takes it",
    ),
    "needs a link": (changed(GoodChannel, "transmit", lambda _, answer, d, *__: d[0] >= 0 and answer), "IndexError"),
}


def powered(power: Any) -> Any:
    return having(GoodVehicle, power=lambda _self, states, *_: power(states))


def blown_up(hidden: Any) -> Any:
    hidden["thrust"] += 1.0
    return hidden


VEHICLES: dict[str, tuple[Any, str]] = {
    "another row": (part(GoodVehicle, 0, lambda states, *_: states - 1e-3 * states.sum(axis=0)), "than alone"),
    "writes to states": (writing(GoodVehicle, "step", 0), COPY),
    "hidden of another type": (
        part(GoodVehicle, 1, lambda hidden, *_: {"thrust": np.float32(hidden["thrust"])}),
        "hidden.* of `init` it .*; .*keep dtypes and shapes",
    ),
    "power of so many rows": (
        having(GoodVehicle, power=lambda _, states, *__: np.arange(len(states)) // 6 * 1.0),
        "of the rows of several ticks differs",
    ),
    "hidden of one row": (having(GoodVehicle, init=lambda *_: {"thrust": np.zeros((1, 2))}), "leading axis of 5"),
    "fails in init": (failing(GoodVehicle, "init", ERROR), "`init` failed: KeyError"),
    "a column of power": (powered(lambda states: np.ones((len(states), 1))), r"power \(5, 1\) of 5 UAVs"),
    "infinite power": (powered(lambda states: np.full(len(states), np.inf)), "not finite"),
    "power beyond all bounds": (powered(lambda states: np.full(len(states), 1e39)), r"a power of 1e\+39 W"),
    "power below zero": (powered(lambda states: -np.ones(len(states))), "below zero"),
    "columns are a text": (having(GoodVehicle, columns="tilt"), r"`columns` is a text; write \('tilt',\)"),
    "shows nothing": (having(GoodVehicle, columns=("tilt",)), "`shown` failed: NotImplementedError"),
    "shows too much": (
        having(GoodVehicle, columns=("tilt",), shown=lambda _, hidden: hidden["thrust"]),
        r"`shown` returns float64 \(5, 2\); return finite float64 \(5, 1\)",
    ),
    "shows another row": (
        having(
            GoodVehicle, columns=("x",), shown=lambda _, hidden: hidden["thrust"][:1, :1] + 0 * hidden["thrust"][:, :1]
        ),
        "than alone",
    ),
    "columns are no tuple": (having(GoodVehicle, columns=4), r"`columns` is 4; write a tuple of names"),
    "a column of another": (
        having(GoodVehicle, columns=("x_m",)),
        "`columns` x_m: the time series has columns of that",
    ),
    "shows a NaN": (
        having(GoodVehicle, columns=("tilt",), shown=lambda _, hidden: np.nan * hidden["thrust"][:, :1]),
        "`shown` returns a number that is not finite",
    ),
    "writes when it shows": (
        having(GoodVehicle, columns=("tilt",), shown=lambda _, hidden: hidden["thrust"].__iadd__(1.0)[:, :1]),
        "`shown` writes to the hidden state",
    ),
    "writes at rest": (having(GoodVehicle, rest=lambda _, hidden: blown_up(hidden)), "`rest` writes to the hidden"),
    "rests at NaN": (
        having(GoodVehicle, rest=lambda _, hidden: {"thrust": np.nan * hidden["thrust"]}),
        r"at rest\['thrust'\] is not finite",
    ),
    "rests as another row": (
        having(GoodVehicle, rest=lambda _, hidden: {"thrust": 0 * hidden["thrust"] + hidden["thrust"].mean(axis=0)}),
        "at rest of a UAV depends on others",
    ),
    "rests otherwise": (having(GoodVehicle, rest=lambda *_: {}), r"hidden state at rest has \[\]"),
    "rests by itself": (
        having(GoodVehicle, rest=lambda self: {}),
        r"`rest` takes \(self\); write rest\(self, hidden\); no flight takes it",
    ),
    "takes no push": (
        having(GoodVehicle, push=True),
        r"noise\); write step\(self, states, hidden, acceleration, noise, push\); no flight takes it",
    ),
    "needs a UAV": (powered(lambda states: np.full(len(states), states[0, 0] ** 2)), "IndexError"),
}
TABLES = {"controller": CONTROLLERS, "filter": FILTERS, "aggregator": RULES, "channel": CHANNELS, "vehicle": VEHICLES}


@pytest.mark.parametrize(("kind", "mistake"), [(kind, mistake) for kind in TABLES for mistake in TABLES[kind]])
def test_a_wrong_plugin_is_rejected_with_its_mistake_and_what_to_do(kind: str, mistake: str) -> None:
    wrong, expected = TABLES[kind][mistake]
    with pytest.raises(ConformanceError) as caught:
        KINDS[kind].check(wrong)
    text = str(caught.value)
    assert re.match(rf"{wrong.__name__}: .*; \S", text)
    assert re.search(expected, text)


def test_a_slow_controller_is_rejected_before_it_flies_the_trials() -> None:
    ticks = []
    slow = changed(GoodController, "step", lambda _, step, __, tick, *___: ticks.append(tick) or step)
    with pytest.raises(ConformanceError, match="make it quicker, or pass a larger `slow_ms` than 0"):
        KINDS["controller"].check(slow, slow_ms=0.0)
    assert len(ticks) < 20


# -- in a flight, which channels, vehicles and codings end if they are wrong ------------------------------------------


class Remembering(GoodChannel):
    def init(self, uavs: int) -> Any:
        return {"last": np.zeros(uavs)}

    def carry(self, memory: Any, message: Any, rng: np.random.Generator) -> Any:
        return memory, *self.transmit(message.distance_m, message.bits, rng)


CANNOT_BEGIN: list[tuple[Any, str]] = [
    (having(Remembering, init=lambda _, uavs: [uavs]), "memory is a list; expected a dict"),
    (
        having(Remembering, init=lambda *_: {"all": np.zeros((5, 10**8))}),
        "MiB for 5 UAVs; a checkpoint keeps up to 256",
    ),
    (having(Remembering, init=lambda *_: 1 / 0), "ZeroDivisionError"),
    (having(GoodVehicle, init=lambda *_: {"charge_J": np.full(3, 1.0)}), r"hidden\['charge_J'\] has shape \(3,\)"),
    (having(GoodVehicle, columns=("tilt",)), "a vehicle that declares `columns` must override `shown`"),
    (
        having(GoodVehicle, columns=("tilt",), shown=lambda _, hidden: hidden["thrust"].__iadd__(1.0)[:, :1]),
        "`shown` failed: ValueError: .*read-only",
    ),
    (having(GoodAggregator, state_bytes="4"), "`state_bytes` is '4'; expected a whole number of at least 0"),
    (having(GoodAggregator, note_bytes=-1), "`note_bytes` is -1; expected a whole number of at least 0"),
    (having(GoodCoding, bits="8"), r"`bits` is '8'; of integers expected one of \(1, 2, 4, 8\)"),
    (having(GoodCoding, largest="all"), "`largest` is 'all'; expected a finite number greater than 0"),
    (failing(GoodCoding, "encode", ERROR), "`encode` failed: KeyError: 'weights'"),
    (having(GoodCoding, encode=lambda *_: None), "`encode` returns a NoneType; expected numbers and scales"),
    (part(GoodCoding, 0, lambda numbers, *_: numbers.tolist()), r"numbers: a list, expected uint8 \(1, 246\)"),
    (part(GoodCoding, 0, lambda numbers, *_: numbers + np.uint8(200)), "of 4 bits expected numbers below 16"),
    (part(GoodCoding, 1, lambda scales, *_: scales[:, :1]), r"scales: float32 \(1, 1\), expected float32 \(1, \d\)"),
    (changed(GoodCoding, "decode", lambda _, found, *__: np.float32(found)), "weights: float32 .* expected float64"),
    (having(GoodCoding, valid=lambda *_: True), "`valid` failed: TypeError: mask: a bool, expected bool"),
]
GOES_WRONG: list[tuple[Any, str]] = [
    (part(GoodChannel, 0, lambda slots, *_: slots - 4), "slots from -3 to 0"),
    (having(GoodChannel, clamped=lambda *_: 1 / 0), "failed: ZeroDivisionError"),
    (having(GoodChannel, clamped=lambda *_: "no"), "`clamped` returns 'no'; expected a whole number of at least 0"),
    (having(GoodChannel, expected=lambda *_: "many"), "`expected` returns 'many'"),
    (having(Remembering, carry=lambda *_: {}), "`carry` returns a dict; expected memory, slots and delivered"),
    (changed(Remembering, "carry", lambda _, answer, *__: ({}, *answer[1:])), r"memory has \[\]; of `init` it had"),
    (writing(Remembering, "carry", 0, "last"), "read-only"),
    (changed(Remembering, "carry", lambda _, answer, *__: (*answer, answer[1] - 9)), "a frame waits -8 to"),
    (changed(Remembering, "carry", lambda _, answer, *__: (*answer, 3)), "waiting slots: "),
    (having(GoodChannel, foreseen=lambda _, __, sent: (sent.distance_m + 2, sent.distance_m)), "they are in .0, 1."),
    (part(GoodVehicle, 1, lambda hidden, *_: {"thrust": hidden["thrust"] / 0}), r"thrust'\] of UAV 0: .* not finite"),
    (part(GoodVehicle, 0, lambda states, *_: states * np.array([1, 1, np.nan, 1, 1])[:, None]), "states of UAV 2"),
    (part(GoodVehicle, 1, lambda *_: {}), r"hidden has \[\]"),
    (powered(lambda states: np.full(len(states), 1e39)), r"power has 1e\+39; expected numbers within ±1e\+30"),
    (powered(lambda states: 1.0 - np.arange(len(states)) % 5), "power of UAV 4: -3 W; expected 0 or more"),
    (
        changed(GoodCoding, "encode", lambda _, answer, models: answer if models.round < 2 else 1 / 0),
        "`encode` failed: ZeroDivisionError: division by zero",
    ),
    (
        changed(GoodCoding, "decode", lambda self, weights, *_: weights * (1.0 if calls(self) < 2 else np.inf)),
        "`decode` failed: ValueError: the weights of finite numbers and scales are not finite",
    ),
    (writing(GoodVehicle, "step", 0), "ValueError: .*read-only"),
    (
        changed(
            having(GoodVehicle, rest=lambda _, hidden: {"thrust": np.nan * hidden["thrust"]}),
            "step",
            lambda _, answer, *__: (answer[0] * 1e9, answer[1]),
        ),
        r"hidden\['thrust'\] at rest of UAV 0: .* not finite",
    ),
    (changed(GoodVehicle, "power", lambda _, power, *__: power[:, None]), r"\(150, 1\).*of the rows of 30 ticks of 5"),
]


def flown(plugin: Any) -> Engine:
    keys = {
        "aggregator": "federation.aggregation",
        "channel": "radio.model",
        "coding": "federation.payload",
        "vehicle": "vehicle.model",
    }
    key, method = keys[plugin.plugin_kind], "mfgfl-hf" if plugin.plugin_kind == "coding" else "hjb"
    rounds = ["federation.period=10"] if plugin.plugin_kind == "coding" else []
    plugins.register(plugin)
    return Engine(load(None, ["uavs=5", f"{key}=good", "duration=3", *rounds], method=method), "wrong")


@pytest.mark.parametrize(("wrong", "expected"), CANNOT_BEGIN)
def test_a_plugin_of_the_world_or_the_leader_that_cannot_begin_is_bad_input(wrong: Any, expected: str) -> None:
    with pytest.raises(BadInput, match=f"(aggregator|channel|vehicle|coding) 'good': .*{expected}"):
        flown(wrong)


@pytest.mark.parametrize(("wrong", "expected"), GOES_WRONG)
def test_a_wrong_channel_vehicle_or_coding_ends_the_run_with_its_mistake(wrong: Any, expected: str) -> None:
    engine = flown(wrong)
    with pytest.raises(RunFailed, match=f"(channel|vehicle|coding) 'good': .*{expected}"), np.errstate(all="ignore"):
        engine.complete()


@pytest.mark.parametrize("method", ["power", "step"])
def test_a_vehicle_that_fails_in_flight_ends_a_flight_with_messages_with_its_mistake(method: str) -> None:
    def fail(_self: Any, answer: Any, states: Any, *_rest: Any) -> Any:
        return answer if states[:, 0].max() < 4.0 else 1 / 0

    plugins.register(changed(GoodVehicle, method, fail))
    flight = load(None, ["uavs=5", "vehicle.model=good", "duration=5"], method="hjb")
    record = Record()
    swarm = MemorySwarm(flight, "wrong", sinks=[record])
    with pytest.raises(RunFailed, match=r"vehicle 'good': .*ZeroDivisionError") as failed:
        swarm.complete()
    assert record.texts[-1] == str(failed.value)
    assert swarm.station is not None
    assert not swarm.station.dropped


def test_a_checkpoint_with_another_memory_of_a_channel_is_refused() -> None:
    medium = flown(Remembering).world.air
    with pytest.raises(ValueError, match=r"memory\['last'\] is \(4,\) float64"):
        restore(medium, state_of(medium) | {"memory": {"last": np.zeros(4)}})
