"""A flight says once that a plug-in draws from a global random generator, because other processes fly another one."""

import random
from pathlib import Path
from typing import Any

import pytest

import meanflock as mf
from meanflock.swarm import global_generators, plugins
from meanflock.swarm.events import GlobalDraw
from meanflock.swarm.global_generators import DrawWatch, Generators, global_state
from meanflock.swarm.scenario import Scenario, load
from tests.faults import drawing
from tests.memory_swarm import MemorySwarm
from tests.telemetry import Record, fly
from tests.testing.good import GoodVehicle, calls

KEYS = {
    "controller": "method",
    "filter": "filter.kind",
    "aggregator": "federation.aggregation",
    "channel": "radio.model",
    "coding": "federation.payload",
    "vehicle": "vehicle.model",
    "topology": "federation.topology",
}
TRACE = Path(__file__).parents[2] / "examples" / "trace.parquet"
STATION = "stations=[{place=[0.0,0.0,25.0]}]"
NEEDS = {  # settings without which one of meanflock's own plug-ins does not fly
    "trace": (f"vehicle.options.file={TRACE}", "uavs=25"),
    "quadrotor": ("space.dimensions=3",),
    "multirotor": ("space.dimensions=3",),
    "float64": ("radio.bits_per_float=64",),
    "clusters": ("federation.clusters=2",),
    "stations": (STATION, "radio.model=link-budget", "federation.station=0"),
}


def flown(plugin: type, key: str, *settings: str) -> Scenario:
    name = plugins.register(plugin).name
    return load(None, [*drawing.SETTINGS, f"{key}={name}", *settings])


def draws(record: Record) -> list[GlobalDraw]:
    return [event for event in record.events if isinstance(event, GlobalDraw)]


@pytest.mark.parametrize("kind", drawing.KINDS)
def test_a_plugin_of_any_kind_that_draws_is_named_once_in_one_process_and_on_a_bus(kind: str) -> None:
    plugin, tick = drawing.KINDS[kind]
    key = KEYS[kind.partition(" ")[0]]
    (event,) = draws(fly(flown(plugin, key))[1])
    assert event.tick == tick
    assert event.text.startswith(f"{kind.partition(' ')[0]} {plugin.name!r} draws from a global random generator, so ")
    record = Record()
    MemorySwarm(flown(plugin, key), "draws", uavs_per_node=2, sinks=[record]).complete()
    assert [each.text for each in draws(record)] == [event.text]


def test_a_draw_after_the_first_tick_is_found_too() -> None:
    class Late(GoodVehicle):
        def step(self, *given: Any) -> Any:
            if calls(self) == 20:
                random.random()
            return super().step(*given)

    (event,) = draws(fly(flown(Late, "vehicle.model", "duration=11"))[1])
    assert event.tick == 101


def test_a_draw_is_printed_in_one_line(capsys) -> None:
    mf.fly(method=drawing.Controller, uavs=3, duration=2)
    assert capsys.readouterr().err.splitlines() == [
        "warning: controller 'draws' draws from a global random generator, so other processes fly another flight; draw "
        "from mf.seeds.generator instead, or from what the method is given"
    ]


def test_what_callers_and_trainings_draw_is_no_draw_of_a_plugin() -> None:
    watch = DrawWatch()
    with Generators(seed=1):
        random.random()
        assert not watch.finds_a_draw_now()
    assert not watch.finds_a_draw_now()
    plugins.register(GoodVehicle)
    flight = mf.Stepped(uavs=3, duration=2, **{"vehicle.model": "good"})
    while not flight.over:
        flight.step(-0.02 * flight.states[:, :2] + random.random())
    assert "random" not in [event["kind"] for event in flight.finish().events]
    assert watch.finds_a_draw_now()
    assert not watch.finds_a_draw_now()


def test_a_training_that_begins_while_the_states_are_compared_is_no_draw_of_a_plugin(monkeypatch) -> None:
    watch = DrawWatch()

    def disturbed() -> tuple[Any, ...]:
        with Generators(seed=1):
            return global_state()

    with monkeypatch.context() as patched:
        patched.setattr(global_generators, "global_state", disturbed)
        assert not watch.finds_a_draw_now()
    assert not watch.finds_a_draw_now()


@pytest.mark.parametrize(
    ("kind", "name"),
    [(one.kind, one.name) for one in plugins.installed() if one.kind in KEYS and plugins.is_own(one)],
)
def test_no_plugin_of_meanflock_draws_from_a_global_generator(kind: str, name: str) -> None:
    before = global_state()
    summary, record = fly(load(None, [*drawing.SETTINGS, "uavs=6", f"{KEYS[kind]}={name}", *NEEDS.get(name, ())]))
    assert global_state() == before
    assert summary["ticks"] == 120
    assert draws(record) == []
