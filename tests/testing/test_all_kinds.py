"""The suites accept the built-in plug-ins and examples, and reject what is wrong with a plug-in of any kind."""

import ast
import random
import re
import time
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from meanflock.agent.controllers.base import Step
from meanflock.swarm import plugins, threads
from meanflock.swarm.scenario import Scenario
from meanflock.testing import ConformanceError
from tests.channel.bursts import Bursts
from tests.testing.good import KINDS, GoodAggregator, Kind, calls, changed, failing, having

EXAMPLE = Path(__file__).parents[2] / "examples"
SHARING = ("vasarhelyi", "olfati-saber", "potential-field", "bvc", "orca")
every = pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)


def shifted(kind: Kind, shift: Callable[[Any], Any]) -> type:
    """A class that adds a number to what a good one returns; `shift` makes it of the instance."""

    def change(self: Any, answer: Any, *_: Any) -> Any:
        number = shift(self)
        if isinstance(answer, Step):
            return msgspec.structs.replace(answer, acceleration=answer.acceleration + number)
        parts = list(answer)
        parts[kind.position] = parts[kind.position] + number
        return tuple(parts)

    return changed(kind.good, kind.method, change)


class RowForEachUav(GoodAggregator):
    """Remembers the last upload of every UAV of the swarm."""

    def init(self, parameters: int) -> dict[str, Any]:
        return {"last": np.zeros((self.scenario.uavs, parameters))}

    def step(self, state: Any, uploads: Any) -> Any:
        last = state["last"].copy()
        last[uploads.uavs] = uploads.models
        return {"last": last}, last.mean(axis=0)


EXAMPLES: dict[str, tuple[str, dict[str, Any]]] = {  # kind of the last plug-in of a file, and options
    "spring": ("controller", {"stiffness": 0.05}),
    "trim": ("controller", {"stiffness": 0.05}),
    "scaffold": ("controller", {}),
    "classifier": ("controller", {"steps": 12, "batch": 4}),
    "momentum": ("aggregator", {"beta": 0.9}),
    "fedadam": ("aggregator", {}),
    "fedbuff": ("aggregator", {}),
    "inverse_probability": ("aggregator", {}),
    "qsgd": ("coding", {}),
    "signsgd": ("coding", {}),
    "copter": ("vehicle", {"lag_s": 0.5}),
}
DISCS = [{"centre": (140.0, 96.0), "radius": 4.0}, {"centre": (152.0, 90.0), "radius": 3.0}]
DISCS += [{"polygon": ((143.0, 90.0), (147.0, 90.0), (145.0, 92.0), (146.0, 96.0))}]
POLICIES = ({"policy": "tick", "forget_s": 0.2}, {"repeats": 3, "delta_m": 0.02})
ECBF, TICK = {"filter.kind": "ecbf"}, {"sharing.policy": "tick"}
SOON: dict[str, Any] = {"uavs": 6, "federation.period": 15}  # two rounds are shorter
SOONER = dict.fromkeys(("mfgfl-f", "mfgfl-h", "mfgfl-hf"), SOON)
SPACE: dict[str, Any] = {"uavs": 6, "space.dimensions": 3, "start.layers": 2, "start.spacing": 1.0}
SKY: dict[str, Any] = {
    "space.floor": 38.0,
    "space.ceiling": 42.0,
    "obstacles": [
        {"centre": (140.0, 96.0, 40.0), "radius": 4.0},
        {"centre": (152.0, 90.0), "radius": 3.0, "height": 40.5},
        {"polygon": ((143.0, 90.0), (147.0, 90.0), (145.0, 92.0), (146.0, 96.0)), "height": 39.0},
    ],
}
SPATIAL = [
    name
    for name in plugins.names("controller")
    if 3 in plugins.registry.dimensions_of(plugins.load("controller", name))
]
NEEDS_A_FILE = {"trace"}  # tests/worldsim/test_trace.py checks it
# Kind, plug-in, options, and keys of the scenario, if it is not that of the suite.
CONFORMING: list[tuple[str, Any, dict[str, Any], dict[str, Any]]] = [
    *(
        (kind, name, {}, SOONER.get(name, {}))
        for kind in KINDS
        for name in (*plugins.names(kind), KINDS[kind].good)
        if name not in NEEDS_A_FILE
    ),
    *(("filter", name, {}, {"uavs": 6, "filter.kind": name, **TICK}) for name in plugins.names("filter")),
    *(
        ("controller", name, {}, {"uavs": 6, **ECBF, "sharing.delta_m": 0.05} | SOONER.get(name, {}))
        for name in plugins.names("controller")
    ),
    *(("controller", name, {}, {"uavs": 6, **ECBF, **TICK} | SOONER.get(name, {})) for name in ("mfgfl-hf", "orca")),
    *(("controller", "windmap", {"share": share}, SOON) for share in ("none", "weights", "precision", "measurements")),
    *(
        ("controller", name, {}, {"uavs": uavs, "obstacles": DISCS, "start.spacing": 0.5, "sharing": policy})
        for name, uavs, policy in product(SHARING, (1, 6), POLICIES)
    ),
    *(("controller", name, {}, {**SPACE, **ECBF, **TICK} | SOONER.get(name, {})) for name in SPATIAL),
    *(("controller", name, {}, {**SPACE, **SKY}) for name in SHARING),
    *(("filter", name, {}, {**SPACE, **SKY, "filter.kind": name}) for name in plugins.names("filter")),
    *(
        ("vehicle", name, {}, {**SPACE, "uavs": 5, "wind.field_rms": 1.0})
        for name in plugins.names("vehicle")
        if name not in NEEDS_A_FILE
    ),
    *(("aggregator", rule, {}, {"uavs": uavs}) for rule, uavs in product((GoodAggregator, RowForEachUav), (1, 60))),
    *((kind, EXAMPLE / f"{file}.py", options, {}) for file, (kind, options) in EXAMPLES.items()),
    ("channel", Bursts, {}, {}),
    ("controller", EXAMPLE / "classifier.py", {"share": False}, {}),
    ("aggregator", EXAMPLE / "scaffold.py", {}, {}),
]


@pytest.mark.parametrize(("kind", "plugin", "options", "keys"), CONFORMING)
def test_what_is_built_in_or_an_example_conforms(kind: Any, plugin: Any, options: Any, keys: Any) -> None:
    if isinstance(plugin, Path):
        (plugin,) = (found.name for found in plugins.load_file(plugin) if found.kind == kind)
    checked = plugins.load(kind, plugin) if isinstance(plugin, str) else plugin
    KINDS[kind].check(checked, options, **({"scenario": Scenario(**keys)} if keys else {}))


@pytest.mark.parametrize("file", ["spring", "fedadam", "fedbuff", "inverse_probability", "scaffold", "qsgd", "signsgd"])
def test_an_example_of_an_algorithm_is_short_and_imports_nothing_internal(file: str) -> None:
    text = (EXAMPLE / f"{file}.py").read_text(encoding="utf-8")
    classes = [node for node in ast.parse(text).body if isinstance(node, ast.ClassDef)]
    assert max(len(ast.unparse(ast.Module(node.body[1:], [])).splitlines()) for node in classes) <= 30
    assert file != "spring" or len(text.splitlines()) <= 25
    imported = set(re.findall(r"^(?:import|from) (\w+)", text, flags=re.M))
    assert imported <= {"typing", "functools", "math", "numpy", "msgspec", "meanflock"}


def waiting(kind: Kind) -> type:
    """A class that takes two milliseconds more than the good one."""

    def wait(_self: Any, answer: Any, *_: Any) -> Any:
        time.sleep(0.002)
        return answer

    return changed(kind.good, kind.method, wait)


def with_a_net_in_self(kind: Kind) -> type:
    """A class whose `init` leaves something in `self` that its main method needs."""

    def init(self: Any, *given: Any) -> Any:
        self.net = 0
        return super(wrong, self).init(*given)

    wrong = shifted(kind, lambda self: self.net)
    wrong.init = init  # type: ignore[attr-defined]
    return wrong


FAILED = r"`{0.method}`.* failed.*: {1} \(good.py, line \d+\); .+"
DIFFERED = "differed in a second run.*; .*{0.remedy}"
DRAWS = "it draws from a global random generator of Python or NumPy; .*{0.remedy}"
MISTAKES: dict[str, tuple[Callable[[Kind], Any], str]] = {  # what is checked, and a part of the verdict
    "no name": (lambda kind: having(kind.good, name=""), "no `name`.*; .+"),
    "a path": (lambda kind: having(kind.good, name="../elsewhere"), "a name is up to 64 of.*; .+"),
    "cannot be made": (
        lambda kind: having(kind.good, __init__=lambda *_: [].pop()),
        r"cannot be made: IndexError: .* \(test_all_kinds.py, line \d+\).*; .+",
    ),
    "a text": (lambda _: "good", "it is no class; pass the class itself"),
    "an object": (lambda _: object(), "it is no class; pass the class itself"),
    "lacks a method": (lambda kind: type("Wrong", kind.good.__bases__, {"name": "lacking"}), "lacks .*`{0.method}`"),
    "exits": (lambda kind: failing(kind.good, kind.method, SystemExit(3)), FAILED.replace("{1}", "SystemExit: 3")),
    "raises": (lambda kind: failing(kind.good, kind.method, OSError("no")), FAILED.replace("{1}", "OSError: no")),
    "draws of Python": (lambda kind: shifted(kind, lambda _: random.randrange(9)), DRAWS),
    "draws of NumPy": (lambda kind: shifted(kind, lambda _: np.random.randint(9)), DRAWS),  # noqa: NPY002
    "draws in vain": (lambda kind: shifted(kind, lambda _: 0 * random.randrange(9)), DRAWS),
    "draws unseeded": (lambda kind: shifted(kind, lambda _: int(np.random.default_rng().integers(9))), DIFFERED),
    "remembers beside its arrays": (lambda kind: shifted(kind, calls), "from a checkpoint differ.*; .*keep"),
    "a net in self": (
        with_a_net_in_self,
        r"failed.*: AttributeError: .*'net'.*; what `init` or .* leaves in `self` is gone after a checkpoint: make .*",
    ),
    "slow": (waiting, r"{0.pace} takes \d+ ms; make it quicker, or pass a larger `slow_ms`"),
}


@pytest.mark.parametrize(
    ("name", "mistake"),
    [each for each in product(KINDS, MISTAKES) if each != ("coding", "a net in self")],  # a coding has no `init`
)
def test_a_mistake_of_any_kind_of_plugin_is_rejected_with_what_to_do(name: str, mistake: str) -> None:
    kind = KINDS[name]
    make, expected = MISTAKES[mistake]
    with pytest.raises(ConformanceError, match=expected.format(kind)) as caught:
        kind.check(make(kind), **{"slow_ms": 1.0} if mistake == "slow" else {})
    assert str(caught.value).startswith("Wrong: ") or mistake in ("a text", "an object")


@pytest.mark.parametrize("name", ["controller", "filter", "vehicle"])
def test_what_flies_is_checked_in_every_dimension_that_it_declares(name: str) -> None:
    class Wrong(KINDS[name].good):  # type: ignore[misc,name-defined]
        dimensions: tuple[int, ...] = (2, 3)

        def __init__(self, *given: Any) -> None:
            super().__init__(*given)
            assert self.scenario.dimensions == 2

    with pytest.raises(ConformanceError, match="AssertionError"):
        KINDS[name].check(Wrong)
    Wrong.dimensions = (3,)
    with pytest.raises(ConformanceError, match="flies in 3 dimensions, and the scenario has 2; declare `dimensions`"):
        KINDS[name].check(Wrong, scenario=Scenario())


def test_a_controller_that_learns_once_a_round_is_seen_learning() -> None:
    """What it learns stays in `self`; its period is longer than any other trial."""

    def learned(self: Any) -> float:
        self.rounds = getattr(self, "rounds", 0) + (calls(self) % 50 == 0)
        return float(self.rounds)

    wrong = shifted(KINDS["controller"], learned)
    wrong.period_ticks = 50  # type: ignore[attr-defined]
    with pytest.raises(ConformanceError, match=r"from a checkpoint differs in tick 4.*keep what changes in the arrays"):
        KINDS["controller"].check(wrong)


def test_a_rule_may_be_made_for_one_size_of_models() -> None:
    class Blocks(GoodAggregator):
        def init(self, parameters: int) -> dict[str, Any]:
            return {"last": np.zeros(parameters), "blocks": np.zeros(parameters).reshape(5, 7)}

        def step(self, state: Any, uploads: Any) -> Any:
            after, model = super().step(state, uploads)
            return after | {"blocks": model.reshape(5, 7)}, model

    check = KINDS["aggregator"].check
    check(Blocks, parameters=35)
    with pytest.raises(ConformanceError, match="cannot reshape"):
        check(Blocks)


def test_a_vehicle_has_its_options_and_scenario() -> None:
    class Optional(KINDS["vehicle"].good):  # type: ignore[misc, name-defined]
        class Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
            mass_kg: float = 1.0

        def power(self, states: Any, hidden: Any, acceleration: Any) -> Any:
            return self.options.mass_kg * self.scenario.dt * np.ones(len(states))

    KINDS["vehicle"].check(Optional, {"mass_kg": 2.0})


@every
def test_bits_that_depend_on_the_number_of_threads_are_rejected(kind: Kind) -> None:
    def number(_: Any) -> int:
        return max((pool.get() for pool in threads._pools()), default=1)

    with pytest.raises(
        ConformanceError, match=r"^Wrong: .* with 2 threads of BLAS.* is not bit-identical; .*`torch.set_num_threads"
    ):
        kind.check(shifted(kind, number))


@every
def test_options_that_do_not_fit_are_rejected(kind: Kind) -> None:
    with pytest.raises(ConformanceError, match=r"its options .*'unknown': 0.5.* do not fit"):
        kind.check(kind.good, {"unknown": 0.5})


@pytest.mark.parametrize("kind", [KINDS[name] for name in ("filter", "aggregator", "channel", "coding", "vehicle")])
def test_a_method_that_returns_one_value_instead_of_two_is_rejected(kind: Kind) -> None:
    wrong = changed(kind.good, kind.method, lambda _self, answer, *_: answer[0])
    with pytest.raises(ConformanceError, match=rf"^Wrong: .*`{kind.method}` returns a \w+[;,]"):
        kind.check(wrong)
