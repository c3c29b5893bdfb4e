"""Random scenarios, with values that the types of all keys allow: each flies alike in every form.

The forms are one node, several nodes, nodes that send messages, and flights that are resumed. Keys that contradict
others are left out, one by one, until the rest flies. A new key is tried without a line here.
"""

import math
import random
from collections.abc import Callable, Iterator
from typing import Any
from unittest.mock import patch

from msgspec import inspect

from meanflock.federation.plan import plan_of
from meanflock.launch import engine
from meanflock.launch.engine import Engine
from meanflock.swarm import plugins
from meanflock.swarm.errors import BadInput, RunFailed
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.scenario.values import PLUGIN_KEYS
from meanflock.swarm.threads import limited
from meanflock.worldsim.checkpoint import EVERY_TICKS
from tests.golden.flights import steady
from tests.memory_swarm import MemorySwarm
from tests.telemetry import Record, comparable, fly

_DURATION_S = 12.0
_LARGE = ("uavs", "seed", "dt", "duration", "until", "density", "offline", "pace")  # they make flights long, or wait
_SHARE = 0.12  # of all keys that are set
_SHARE_OF_TABLE = 0.3  # likewise, in the tables of a list
_OFTEN = {"method": 1.0, "filter.kind": 0.3, "space.dimensions": 0.3, "groups": 0.4, "faults": 0.5, "radio.model": 0.3}
_OFTEN |= {"obstacles": 0.3, "stations": 0.3, "energy.battery_J": 0.3, "destination.waypoints": 0.3}
_NAMED = {key: kind for key, kind in PLUGIN_KEYS.items() if kind != "learner"}  # no learner is built in
_IDENTITY = {"kind", "name", "count", "method"}  # keys that stay as long as their table does
_UNSET = object()


def drawn(seed: int) -> Scenario:
    """A scenario of at most nine UAVs that can fly."""
    draw = random.Random(seed)
    uavs = draw.choice([1, 2, 5, 7, 9])
    keys = _table(draw, inspect.type_info(Scenario), "", uavs)
    keys |= {"federation.period": draw.choice([20, 30, 45]), "density.near_samples": 100, "density.box_samples": 100}
    while True:
        _count(keys, uavs)
        try:
            scenario = Scenario(seed=seed % 1000 + 1).replace(uavs=uavs, duration=_DURATION_S, **keys)
            Engine(scenario, "tried")
            return scenario
        except BadInput as error:
            _leave_out(draw, keys, str(error))


def _count(keys: dict[str, Any], uavs: int) -> None:
    """Name the groups, and divide the UAVs among them."""
    groups = keys.get("groups", [])
    del groups[uavs:]
    for number, group in enumerate(groups):
        group["name"], group["count"] = "abc"[number], uavs // len(groups) + (number < uavs % len(groups))


def _leave_out(draw: random.Random, keys: dict[str, Any], error: str) -> None:
    """Leave out a key that an error names, or any; of a list of tables a key of one table, or a table."""
    key = draw.choice([key for key in keys if key in error] or list(keys))
    if isinstance(keys[key], list) and isinstance(keys[key][0], dict):
        table = draw.choice([one for place, one in enumerate(keys[key]) if f"[{place}]" in error] or keys[key])
        if free := table.keys() - _IDENTITY:
            del table[draw.choice(sorted(free))]
            return
        keys[key].remove(table)
        if keys[key]:
            return
    del keys[key]


def unlike(scenario: Scenario, draw: random.Random) -> list[str]:
    """Fly a scenario in every form; what differs from the flight in one node."""
    whole, record = _flown(scenario)
    nodes = draw.randint(1, max(1, scenario.uavs - 1))
    forms = {f"{nodes} UAVs a node": (0, _flown(scenario, rows=nodes))}
    with limited():
        forms["with messages"] = 0, _flown(scenario, flight=_with_messages)
    for past in record.checkpoints[1:]:
        forms[f"resumed at tick {past.tick}"] = past.block + 1, _flown(scenario, resume=past)
    return [
        f"{form}: {name}"
        for form, (block, (one, flown)) in forms.items()
        for name, same in {
            **{name: one.get(name) == whole.get(name) for name in whole.keys() | one},
            "events": comparable(flown.events) == comparable(record.events_from(block)),
        }.items()
        if not same
    ]


def broken(seeds: range) -> Iterator[str]:
    """A line for each scenario of some seeds whose flights differ, or that raises an error."""
    for seed in seeds:
        try:
            with patch.object(engine, "_CHECKPOINT_TICKS_AT_MOST", EVERY_TICKS):
                found = unlike(drawn(seed), random.Random(seed))
        except Exception as error:
            found = [f"{type(error).__name__}: {error}"]
        yield from (f"scenario {seed}: {text}" for text in found)


def _with_messages(scenario: Scenario) -> tuple[dict[str, Any], Record]:
    """A flight whose nodes, one for each group, send bytes."""
    record = Record()
    sizes = [len(group.uavs) for group in plan_of(scenario).groups]
    return MemorySwarm(scenario, "messages", uavs_per_node=sizes, sinks=[record]).complete(), record


def _flown(
    scenario: Scenario, flight: Callable[..., tuple[dict[str, Any], Record]] = fly, **how: Any
) -> tuple[dict[str, Any], Record]:
    """The steady part of a summary, or how the flight failed; and what was recorded of it."""
    try:
        summary, record = flight(scenario, **how)
    except RunFailed as error:
        return {"failed": type(error).__name__}, Record()
    return steady(summary), record


def _table(draw: random.Random, table: Any, prefix: str, uavs: int) -> dict[str, Any]:
    """Some keys of a table, dotted."""
    keys: dict[str, Any] = {}
    for field in table.fields:
        name = prefix + field.name
        if field.name in _LARGE:
            continue
        kind = _plain(field.type)
        if isinstance(kind, inspect.StructType) and not prefix:
            keys |= _table(draw, kind, f"{name}.", uavs)
        elif draw.random() < _OFTEN.get(name, _SHARE):
            default = None if field.default is inspect.NODEFAULT else field.default
            if (value := _value(draw, field.type, name, default, uavs)) is not _UNSET:
                keys[name] = value
    return keys


def _struct(draw: random.Random, kind: Any, uavs: int) -> dict[str, Any]:
    """A table of a list, with what it requires and some of all else."""
    found: dict[str, Any] = {kind.cls.__struct_config__.tag_field: kind.tag} if kind.tag else {}
    for field in kind.fields:
        if field.required or draw.random() < _SHARE_OF_TABLE:
            default = field.default if isinstance(field.default, int | float) else None
            if (value := _value(draw, field.type, field.name, default, uavs)) is not _UNSET:
                found[field.name] = value
    return found


def _plain(kind: Any) -> Any:
    """A type without its description and without None."""
    while isinstance(kind, inspect.Metadata | inspect.UnionType):
        if isinstance(kind, inspect.Metadata):
            kind = kind.type
            continue
        parts = [part for part in kind.types if not isinstance(part, inspect.NoneType)]
        if len(parts) > 1:
            break
        (kind,) = parts
    return kind


def _value(draw: random.Random, kind: Any, name: str, default: Any, uavs: int) -> Any:
    """A value of a type, a number within its bounds and near its default."""
    kind = _plain(kind)
    if isinstance(kind, inspect.UnionType):
        kind = _plain(draw.choice(kind.types))
    match kind:
        case inspect.BoolType():
            return draw.random() < 0.5
        case inspect.LiteralType():
            return draw.choice(kind.values)
        case inspect.StrType():
            return draw.choice(plugins.names(_NAMED[name])) if name in _NAMED else draw.choice("abc")
        case inspect.IntType():
            count = draw.randint(0, uavs) if not default else round(default * 2.0 ** draw.uniform(-2, 2))
            return min(max(count, kind.ge or 0), kind.le if kind.le is not None else count)
        case inspect.FloatType():
            low = kind.ge if kind.ge is not None else kind.gt if kind.gt is not None else -math.inf
            high = kind.le if kind.le is not None else kind.lt if kind.lt is not None else math.inf
            near = default * 10.0 ** draw.uniform(-0.5, 0.5) if default else draw.uniform(-15.0, 15.0)
            return min(max(abs(near) if low >= 0.0 else near, low), high)
        case inspect.StructType():
            return _struct(draw, kind, uavs)
        case inspect.TupleType():
            return [_value(draw, part, name, None, uavs) for part in kind.item_types]
        case inspect.VarTupleType() | inspect.ListType():
            return [_value(draw, kind.item_type, name, None, uavs) for _ in range(draw.randint(1, 3))]
    return _UNSET
