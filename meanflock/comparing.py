"""`mf.compare` and `mf.sweep`: many flights, and a row of means for each point."""

import sys
from collections.abc import Iterable, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from meanflock.comparison import Comparison
from meanflock.launch import memory
from meanflock.launch.temporary import TemporaryFolder
from meanflock.progress import Progress, checked_progress
from meanflock.settings import learner_named, load_plugins, scenario_of, with_settings
from meanflock.studies import after_landing, before_take_off, study
from meanflock.studies.store import Store
from meanflock.studies.swept import add_point, point_of, refuse_twice
from meanflock.swarm import paths
from meanflock.swarm.counts import count_of
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario, as_builtins


@with_settings
def compare(
    methods: Sequence[str | type] | str | type,
    *,
    seeds: int = 8,
    scenario: str | Path | Scenario | None = "paper",
    learner: str | Path | type | None = None,
    plugin: str | Path | Sequence[str | Path] | None = None,
    jobs: int = -1,
    out: str | Path | None = None,
    progress: Progress | None = None,
    **settings: Any,
) -> Comparison:
    """Flies several controllers over the same seeds.

    Args:
        methods: one or several controllers, by name or as classes.
        seeds: number of flights of each controller; their seeds follow on from the scenario's.
        scenario: the name of a shipped scenario, a TOML file, or a Scenario.
        learner: a learner that trains in each flight, as for `mf.fly`.
        plugin: one or several files with plug-ins.
        jobs: number of processes; −1: one for each core. All flights are in this process if a plug-in of theirs was
            registered in it (`mf.register`, or a class that is given), or if this process is a worker of
            `multiprocessing`.
        out: folder for finished flights. After an interruption the same call flies the remaining ones.
        progress: called with the number of finished flights and of all flights.
        settings: any dotted scenario key, as in `**{"wind.sigma": 0.2}`.

    Raises:
        BadInput: an argument cannot be used.
        RunFailed: a process died.
    """
    load_plugins(plugin)
    settings |= _training(learner)
    named = _several("compare", methods, settings)
    points: dict[tuple[Any, ...], Scenario] = {}
    for method in named:
        flown = scenario_of(scenario, settings, method=method)
        add_point(points, point_of(("method",), (), flown), flown)
    return Comparison(("method",), _fly(("method",), points, seeds, _processes(jobs), out, progress))


@with_settings
def sweep(
    key: str | Sequence[str],
    values: Sequence[Any],
    *,
    methods: Sequence[str | type] | str | type | None = None,
    seeds: int = 8,
    scenario: str | Path | Scenario | None = "paper",
    learner: str | Path | type | None = None,
    plugin: str | Path | Sequence[str | Path] | None = None,
    jobs: int = -1,
    out: str | Path | None = None,
    progress: Progress | None = None,
    **settings: Any,
) -> Comparison:
    """Flies a scenario for several values of one of its keys, or for all combinations of the values of several keys.

    Args:
        key: a dotted scenario key, or a list of keys.
        values: values of the key, as a sequence or a NumPy array; of a list of keys a sequence for each, as in
            `mf.sweep(["wind.sigma", "uavs"], [[0.1, 0.3], [9, 25]])`.
        methods: the controllers that fly each value; None: the scenario's. All other arguments are those of `compare`.

    Raises:
        BadInput: an argument cannot be used.
        RunFailed: a process died.
    """
    load_plugins(plugin)
    settings |= _training(learner)
    if not np.iterable(key) or not np.iterable(values):
        raise BadInput(f"sweep: {key!r}: {values!r}; give a key, or a list of keys, and a list of values")
    keys, listed = ([key], [values]) if isinstance(key, str) else (list(key), list(values))
    listed = [each if isinstance(each, str) or not np.iterable(each) else list(each) for each in listed]
    named = [] if methods is None else _several("sweep", methods, settings)
    _check_grid(keys, listed, settings, named)
    names = keys if "method" in keys else [*keys, "method"]
    points: dict[tuple[Any, ...], Scenario] = {}
    for point in product(*listed):
        for method in named or (None,):
            flown = scenario_of(scenario, {**settings, **dict(zip(keys, point, strict=True))}, method=method)
            add_point(points, point_of(names, tuple(map(_hashable, point)), flown), flown)
    return Comparison(tuple(names), _fly(names, points, seeds, _processes(jobs), out, progress))


def _check_grid(
    keys: Sequence[str], listed: Sequence[Any], settings: Mapping[str, Any], methods: Sequence[Any]
) -> None:
    """Check the keys of a sweep and the values of each.

    Raises:
        BadInput: they do not fit together, or another argument sets a key.
    """
    if not keys or len(listed) != len(keys):
        raise BadInput(f"sweep: {len(keys)} keys, and values for {len(listed)}; give each key a list of its values")
    refuse_twice(keys)
    for key, values in zip(keys, listed, strict=True):
        if key in settings or (key == "method" and methods):
            place = "settings" if key in settings else "methods"
            raise BadInput(f"{key} is what is swept; leave it out of the {place}")
        if not isinstance(values, list):
            raise BadInput(f"sweep: {key}: {values!r}; give a list of values")
        if not values:
            raise BadInput(f"sweep: give {key} a value or more")


def _several(function: str, methods: Any, settings: Mapping[str, Any]) -> list[str | type]:
    """The controllers as a list, also if only one was given.

    Raises:
        BadInput: there is none, or the settings name another one.
    """
    named = list(methods) if isinstance(methods, Iterable) and not isinstance(methods, str | type) else [methods]
    if not named or methods is None:
        raise BadInput(f"{function}: name a controller or more")
    if "method" in settings:
        raise BadInput(f"{function}: both `methods` and `method` name controllers; give one of them")
    return named


def _training(learner: str | Path | type | None) -> dict[str, str]:
    """The key of a learner that is given, if one is."""
    return {} if learner is None else {"training.learner": learner_named(learner)}


def _processes(jobs: Any) -> int:
    """Number of processes; negative numbers count down from one a core.

    Raises:
        BadInput: it is not a valid number.
    """
    expected = "give a number of processes, or -1 for one a core"
    if number := count_of("jobs:", jobs, -sys.maxsize, expected=expected):
        return number
    raise BadInput(f"jobs: 0; {expected}")


def _count(seeds: Any) -> int:
    """Number of flights for each point.

    Raises:
        BadInput: it is not a valid number.
    """
    expected = "give how many to fly, one or more: from `seed` on, each the one after it"
    return count_of("seeds:", seeds, 1, expected=expected)


def _hashable(value: Any) -> Any:
    """A value as part of a point: a list as a tuple, a table as text, the class of a plug-in as its name."""
    value = value.name if isinstance(value, type) else as_builtins(value)  # type: ignore[attr-defined]
    if isinstance(value, dict):
        return str(value)
    return tuple(map(_hashable, value)) if isinstance(value, list) else value


def _fly(
    names: Sequence[str],
    scenarios: Mapping[Any, Scenario],
    seeds: Any,
    jobs: int,
    out: str | Path | None,
    progress: Progress | None,
) -> dict[Any, study.Summaries]:
    show, count = checked_progress(progress), _count(seeds)
    memory.check(scenarios.values())
    before_take_off.warn(names, scenarios)
    points = {at: study.seeded(flown, count) for at, flown in scenarios.items()}
    flown = _flown(points, jobs, show, out)
    after_landing.warn(scenarios.values(), [summary for summaries in flown.values() for summary in summaries])
    return flown


def _flown(
    points: Mapping[Any, Sequence[Scenario]], jobs: int, show: Progress, out: str | Path | None
) -> dict[Any, study.Summaries]:
    try:
        if out is not None:
            return study.fly_all(points, jobs, show, Store(paths.given(out)))
        with TemporaryFolder() as folder:
            return study.fly_all(points, jobs, show, Store(folder.path), keeps=False)
    except study.StudyInterrupted as error:
        raise KeyboardInterrupt(str(error)) from None
