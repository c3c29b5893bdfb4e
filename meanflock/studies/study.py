"""Many flights of a user's scenario: several methods, or values of one key.

Finished runs are stored in `OUT/data/jobs` at once, by the hash of scenario and code. A repeated command flies only the
rest.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import zip_longest
from typing import Any

import msgspec

from meanflock.federation.plan import plugins_of
from meanflock.launch import memory
from meanflock.launch.engine import Engine
from meanflock.studies import runner
from meanflock.studies.each_round import EachRound
from meanflock.studies.failure_reasons import FailureReasons
from meanflock.studies.job_file import StoredRun, decode, encode, version
from meanflock.studies.runner import Jobs, WorkerDied
from meanflock.studies.store import Store
from meanflock.swarm import plugins
from meanflock.swarm.declared import NO_LEARNER
from meanflock.swarm.errors import RunFailed
from meanflock.swarm.scenario import Scenario

Summaries = list[dict[str, Any]]
Fly = Callable[[Scenario], dict[str, Any]]

STUDY = "study 4"  # raise the number if `summarised` returns other fields


class StudyInterrupted(RunFailed):
    """Error of a study that Ctrl-C interrupted; the Python API raises KeyboardInterrupt instead."""


def seeded(flown: Scenario, count: int) -> list[Scenario]:
    """The scenario with its own seed and the `count` − 1 after it."""
    return [msgspec.structs.replace(flown, seed=flown.seed + k) for k in range(count)]


def fly_all(
    points: Mapping[Any, Sequence[Scenario]],
    jobs: Jobs,
    progress: Callable[[int, int], None],
    store: Store,
    study: str = STUDY,
    fly: Fly | None = None,
    keeps: bool = True,
) -> dict[Any, Summaries]:
    """Fly the runs that `store` does not have: the first flight of each point, then the second of each, and so on, so
    that the time left can be estimated.

    Args:
        points: name → scenarios that differ in their seeds only.
        jobs: number of processes, -1 for one a core, or the executor of a cluster. Scenarios with a class that was
            registered in this process are flown in it.
        progress: called with the numbers of runs finished and wanted.
        study: first word of the names of its runs in the store.
        fly: flies a scenario, in any process, and returns what the store keeps; None: `summarised`.
        keeps: whether `store` is kept after this call.

    Returns:
        For each point what `fly` returned, in the order of its scenarios.

    Raises:
        BadInput: a flight does not fit into the memory of this machine.
        RunFailed: disk full or a process died, or interrupted (Interrupted); what was finished is kept, the same call
            flies the rest.
    """
    if isinstance(jobs, int):  # a cluster has a memory of its own
        memory.check(flights[0] for flights in points.values())
    keys = {name: [key_of(flown, study) for flown in flights] for name, flights in points.items()}
    finished = {key: run.scalars for key, run in store.finished().items()}
    wanted = [zip(flights, keys[name], strict=True) for name, flights in points.items()]
    turns = (flight for turn in zip_longest(*wanted) for flight in turn if flight is not None)
    missing = [flown for flown, key in turns if key not in finished]
    total = sum(map(len, keys.values()))
    done = total - len(missing)
    if isinstance(jobs, int) and any(map(_is_of_this_process, missing)):
        jobs = 1

    def keep(_flown: Scenario, raw: bytes) -> None:
        nonlocal done
        store.add(raw)
        runs = decode(raw)
        finished.update((run.key, run.scalars) for run in runs)
        done += len(runs)
        progress(done, total)

    progress(done, total)
    try:
        code = version() if isinstance(jobs, int) else None  # a cluster may have other code, which `store` refuses
        runner.run(partial(_fly, study=study, fly=fly or summarised, code=code), missing, jobs, keep)
    except KeyboardInterrupt:
        raise StudyInterrupted(f"interrupted; {_kept(done, total, store if keeps else None)}") from None
    except WorkerDied as error:
        raise RunFailed(f"{error}; {_kept(done, total, store if keeps else None)}") from error
    return {name: [finished[key] for key in keys[name]] for name in points}


def _kept(done: int, total: int, store: Store | None) -> str:
    if store is None:
        return f"{done} of {total} runs were flown and nothing is kept: name a folder for them, out=…"
    return f"{done} of {total} runs are kept in {store.data}: repeat the command to fly the rest"


def _is_of_this_process(flown: Scenario) -> bool:
    """Returns whether a plug-in of a scenario was registered in this process, so that no other process has it."""
    return any(plugins.find(kind, name).source == plugins.HERE for kind, name, _ in plugins_of(flown))


def key_of(flown: Scenario, study: str = STUDY) -> str:
    """Key of a run in the store. It changes with the files of plug-ins and the versions of their packages."""
    found = (plugins.find(kind, name) for kind, name, _ in plugins_of(flown))
    theirs = (plugin for plugin in found if not plugins.is_own(plugin))  # the store knows our version
    return ":".join([study, flown.sha256(), *map(_contents, theirs)])


def _contents(plugin: plugins.Plugin) -> str:
    if plugin.source != plugins.HERE:
        return plugin.fingerprint
    return f"{os.getpid()} {id(plugins.load(plugin.kind, plugin.name))}"  # a class of this process


def _fly(flown: Scenario, study: str, fly: Fly, code: str | None) -> bytes:
    """Flies one run; the content of its file in the store. `code`: its version; None: see `encode`."""
    return encode([StoredRun(key_of(flown, study), fly(flown))], code)


def summarised(flown: Scenario) -> dict[str, Any]:
    """Fly a scenario in this process; returns the summary, see `of_all`, its learner if it has one, its rounds, and the
    reasons of its failures."""
    engine, rounds = Engine(flown, f"{flown.method}-s{flown.seed}"), EachRound(flown.dt)
    failures = FailureReasons(bool(flown.faults))
    for sink in (rounds, failures):
        engine.add_sink(sink)
    learner = {} if flown.training.learner == NO_LEARNER else {"learner": flown.training.learner}
    return {**of_all(flown, engine.complete()), **learner, **rounds.fields, **failures.fields}


def of_all(flown: Scenario, summary: Mapping[str, Any]) -> dict[str, Any]:
    """The summary with `t_avg_censored_s` of all UAVs and of each group, see `_censored`."""
    result = _censored(flown, summary)
    if summary["groups"]:
        result["groups"] = {name: _censored(flown, group) for name, group in summary["groups"].items()}
    return result


def _censored(flown: Scenario, figures: Mapping[str, Any]) -> dict[str, Any]:
    """Figures of some UAVs with `t_avg_censored_s`, their mean travel time: one that never arrived counts with the
    duration. That is a lower bound of the mean, unlike the mean of arrived UAVs.
    """
    arrived, uavs = figures["arrived"], figures["uavs"]
    late = (uavs - arrived) * flown.max_ticks * flown.dt
    mean = ((figures["t_avg_s"] * arrived if arrived else 0.0) + late) / uavs
    return {**figures, "t_avg_censored_s": mean}
