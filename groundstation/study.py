"""Anyone's own scenario, flown many times: several methods side by side, or one key swept."""

import itertools
import json
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from joblib import Parallel, delayed
from msgspec import structs

from groundstation.engine import Engine
from swarm.errors import BadInput
from swarm.scenario import Scenario

Summaries = list[dict[str, Any]]
SEEDS_A_JOB = 1  # a flight a task: all cores have work to the end


def fly_all(
    scenarios: Mapping[Any, Scenario], seeds: Sequence[int], jobs: int, progress: Callable[[int, int], None]
) -> dict[Any, Summaries]:
    """Flies every scenario once a seed, in this process and `jobs` others, without the disk.

    Args:
        scenarios: by whatever tells them apart. progress: called with the runs finished and wanted.

    Returns:
        For each the summaries of its runs, in the order of the seeds.
    """
    chunks = [seeds[i : i + SEEDS_A_JOB] for i in range(0, len(seeds), SEEDS_A_JOB)]
    work = list(itertools.product(scenarios, chunks))
    total = len(scenarios) * len(seeds)
    parallel = Parallel(n_jobs=jobs, return_as="generator")
    flown: dict[Any, Summaries] = {name: [] for name in scenarios}
    results = parallel(delayed(_fly)(scenarios[name], chunk) for name, chunk in work)
    for (name, _), summaries in zip(work, results, strict=True):
        flown[name] += summaries
        progress(sum(map(len, flown.values())), total)
    return flown


def _fly(scenario: Scenario, seeds: Sequence[int]) -> Summaries:
    flown = [structs.replace(scenario, seed=seed) for seed in seeds]
    return [Engine(one, f"{one.method}-s{one.seed}").complete() for one in flown]


def values_of(text: str) -> tuple[str, list[Any]]:
    """`KEY=V1,V2,…` as the key and its values in TOML syntax; bare words are strings.

    Raises:
        BadInput: no key, or fewer than two values.
    """
    key, equals, listed = text.partition("=")
    if not equals or not key.strip():
        raise BadInput(f"{text}: write it as KEY=VALUE,VALUE, for example wind.sigma=0.1,0.2,0.3")
    values = [_value(part.strip()) for part in listed.split(",") if part.strip()]
    if len(values) < 2:
        raise BadInput(f"{text}: a sweep needs two values or more, between commas")
    return key.strip(), values


def _value(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def save(flown: Iterable[Summaries], path: Path) -> None:
    """Writes every summary as one line of JSON.

    Raises:
        BadInput: the file cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        lines = (json.dumps(summary) for summaries in flown for summary in summaries)
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    except OSError as error:
        raise BadInput(f"--out {path.parent}: {error.strerror}; name a folder that can be written") from error
