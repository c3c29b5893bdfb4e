"""`mf.compare` and `mf.sweep`: many flights, a row of means a point."""

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from meanflock.channel.outlook import tell_of_lost_models
from meanflock.settings import load_plugins, scenario_of, with_settings
from meanflock.studies import study
from meanflock.studies.means import Means
from meanflock.studies.store import Store
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario, as_builtins

Progress = Callable[[int, int], None]  # flights finished, and wanted


class Comparison:
    """What a study found; iterate over it for a row a point.

    A row has what tells the points apart, `n` (flights), `uavs`, and of every metric the mean under its name and the
    ends of its 95 % interval under `…_low` and `…_high`; None where unknown. Means over UAVs count one that never
    arrived with the duration.
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
        methods: names, or classes of yours; or one alone.
        seeds: flights of each, from the scenario's seed on.
        scenario: the name of a shipped one, a TOML file, or a Scenario.
        plugin: a file with plug-ins, or several.
        jobs: processes; −1: one a core. All is flown in this one if a class is among the `methods`, and in a worker of
            `multiprocessing`.
        out: a folder in which finished flights are kept: the same call flies the rest.
        progress: called with the flights finished and wanted.
        settings: any dotted key of the scenario, `**{"wind.sigma": 0.2}`.

    Raises:
        BadInput: something asked for cannot be had.
        RunFailed: a process died.
    """
    load_plugins(plugin)
    if not (named := _several(methods)):
        raise BadInput("compare: name a controller or more")
    points = {}
    for method in named:
        flown = scenario_of(scenario, settings, method=method)
        points[(flown.method,)] = study.seeded(flown, _count(seeds))
    return Comparison(("method",), _fly(points, _processes(jobs, named), out, progress))


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
        key: a dotted key of the scenario.
        values: its values; NumPy's will do.
        methods: the controllers that fly each value; None: the scenario's. All else as in `compare`.

    Raises:
        BadInput: something asked for cannot be had.
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
    return Comparison((key, "method"), _fly(points, _processes(jobs, named), out, progress))


def _several(methods: Sequence[str | type] | str | type | None) -> list[str | type]:
    """Controllers, also where one was named alone."""
    return [methods] if isinstance(methods, str | type) else list(methods or ())


def _processes(jobs: int, methods: Sequence[str | type]) -> int:
    """How many fly; a class flies here, where it is registered.

    Raises:
        BadInput: it is no number of them.
    """
    if not isinstance(jobs, int | np.integer) or jobs == 0:
        raise BadInput(f"jobs: {jobs!r}; give a number of processes, or -1 for one a core")
    return 1 if any(isinstance(method, type) for method in methods) else jobs


def _count(seeds: Any) -> int:
    """Flights a point.

    Raises:
        BadInput: it is no number of them.
    """
    if not isinstance(seeds, int | np.integer) or seeds < 1:
        raise BadInput(f"seeds: {seeds!r}; give how many to fly, one or more: from `seed` on, each the one after it")
    return int(seeds)


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
    tell_of_lost_models(flights[0] for flights in points.values())
    try:
        if out is not None:
            return study.fly_all(points, jobs, show, Store(Path(out)))
        with tempfile.TemporaryDirectory(prefix="meanflock-") as folder:
            return study.fly_all(points, jobs, show, Store(Path(folder)), keeps=False)
    except study.Interrupted as error:
        raise KeyboardInterrupt(str(error)) from None
