"""`mf.compare` and `mf.sweep`: many flights, and a row of means for each point."""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from meanflock.channel.outlook import warn_of_lost_models
from meanflock.groundstation import memory
from meanflock.groundstation.temporary import TemporaryFolder
from meanflock.settings import load_plugins, scenario_of, with_settings
from meanflock.studies import study
from meanflock.studies.means import Means
from meanflock.studies.store import Store
from meanflock.swarm import paths
from meanflock.swarm.counts import count_of
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario, as_builtins

Progress = Callable[[int, int], None]  # flights finished, and all flights


class Comparison:
    """The result of a study. Iterate over it to get one row for each point.

    A row is a dict. It has the values that identify the point, `n` (flights), `uavs`, and for each metric the mean
    under its name and the ends of its 95 % interval under `…_low` and `…_high`; None if unknown. `uplink_bits`,
    `relay_bits`, `broadcast_bits` and `state_bits` are the mean payload by kind of traffic. In means over UAVs a UAV
    that never arrived counts with the duration.
    """

    def __init__(self, names: tuple[str, ...], flown: Mapping[tuple[Any, ...], study.Summaries]) -> None:
        self.means = Means(names, flown)

    def __iter__(self) -> Iterator[dict[str, Any]]:
        for values, row in self.means.rows():
            yield dict(zip(self.means.names, values, strict=True)) | row

    def __len__(self) -> int:
        return len(self.means.points)

    def __repr__(self) -> str:
        flights = sum(map(len, self.means.points.values()))
        return f"<Comparison of {len(self)} points of {', '.join(self.means.names)}: {flights} flights>"

    @property
    def summaries(self) -> Mapping[tuple[Any, ...], Sequence[Mapping[str, Any]]]:
        """The summaries of all flights, by point."""
        return self.means.points


@with_settings
def compare(
    methods: Sequence[str | type] | str | type,
    *,
    seeds: int = 8,
    scenario: str | Path | Scenario | None = "paper",
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
        plugin: one or several files with plug-ins.
        jobs: number of processes; −1: one for each core. All flights are in this process if a plug-in of theirs was
            registered in it (`mf.register`, or a class in `methods`), or if this process is a worker of
            `multiprocessing`.
        out: folder for finished flights. After an interruption the same call flies the remaining ones.
        progress: called with the number of finished flights and of all flights.
        settings: any dotted scenario key, as in `**{"wind.sigma": 0.2}`.

    Raises:
        BadInput: an argument cannot be used.
        RunFailed: a process died.
    """
    load_plugins(plugin)
    if not (named := _several(methods)):
        raise BadInput("compare: name a controller or more")
    points = {}
    for method in named:
        flown = scenario_of(scenario, settings, method=method)
        points[(flown.method,)] = study.seeded(flown, _count(seeds))
    return Comparison(("method",), _fly(points, _processes(jobs), out, progress))


@with_settings
def sweep(
    key: str,
    values: Sequence[Any],
    *,
    methods: Sequence[str | type] | str | type | None = None,
    seeds: int = 8,
    scenario: str | Path | Scenario | None = "paper",
    plugin: str | Path | Sequence[str | Path] | None = None,
    jobs: int = -1,
    out: str | Path | None = None,
    progress: Progress | None = None,
    **settings: Any,
) -> Comparison:
    """Flies a scenario for several values of one of its keys.

    Args:
        key: a dotted scenario key.
        values: values of the key, as a sequence or a NumPy array.
        methods: the controllers that fly each value; None: the scenario's. All other arguments are those of `compare`.

    Raises:
        BadInput: an argument cannot be used.
        RunFailed: a process died.
    """
    load_plugins(plugin)
    if key in settings:
        raise BadInput(f"{key} is what is swept; leave it out of the settings")
    points, named = {}, _several(methods)
    for value in values:
        for method in named or (None,):
            flown = scenario_of(scenario, {**settings, key: value}, method=method)
            points[_hashable(value), flown.method] = study.seeded(flown, _count(seeds))
    if not points:
        raise BadInput(f"sweep: give {key} a value or more")
    return Comparison((key, "method"), _fly(points, _processes(jobs), out, progress))


def _several(methods: Sequence[str | type] | str | type | None) -> list[str | type]:
    """The controllers as a list, also if only one was given."""
    return [methods] if isinstance(methods, str | type) else list(methods or ())


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
    """A value as part of a point: a list as a tuple, a table as text."""
    value = as_builtins(value)
    if isinstance(value, dict):
        return str(value)
    return tuple(map(_hashable, value)) if isinstance(value, list) else value


def _fly(
    points: Mapping[Any, Sequence[Scenario]], jobs: int, out: str | Path | None, progress: Progress | None
) -> dict[Any, study.Summaries]:
    show = progress or (lambda _done, _total: None)
    memory.check(flights[0] for flights in points.values())
    warn_of_lost_models(flights[0] for flights in points.values())
    try:
        if out is not None:
            return study.fly_all(points, jobs, show, Store(paths.given(out)))
        with TemporaryFolder() as folder:
            return study.fly_all(points, jobs, show, Store(folder.path), keeps=False)
    except study.Interrupted as error:
        raise KeyboardInterrupt(str(error)) from None
