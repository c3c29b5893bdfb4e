"""Flies the grid in parallel and makes its tables; an interrupted grid can be resumed."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from meanflock.federation.plan import plan_of
from meanflock.studies import runner
from meanflock.studies.job_file import StoredRun, encode
from meanflock.studies.runner import WorkerDied, terminable, workers
from meanflock.studies.store import Store
from meanflock.swarm.errors import BadInput, MeanflockError, RunFailed
from research.reproduction.flight import FlownRun, fly, stored, version
from research.reproduction.grid import EXPERIMENTS, Method, Wanted, wanted
from research.reproduction.tables import Results, tables

_COST = {Method.HJB: (130.0, 4.0), Method.OFFLINE: (80.0, 0.2)}  # µs a tick, and more a UAV; of all others:
_COST_OF_OTHERS = 50.0, 2.0


def run_grid(
    out: Path,
    seeds: int = 30,
    only: set[str] | None = None,
    jobs: int = -1,
    backend: str = "processes",
    scheduler: str | None = None,
    quiet: bool = False,
    plan: Sequence[Wanted] | None = None,
    scenario: Path | None = None,
) -> Results:
    """Fly the missing runs of the grid and make the tables of all finished runs.

    Args:
        out: results go to `out/data`. seeds: per point; S0 gets 10/3 as many, sensitivity 1/3, random 1/6.
        only: names of experiments to fly now; None for all. Other experiments' finished runs stay in the tables.
        jobs: processes, -1 for one a core. backend: "processes" or "dask". scheduler: address of the Dask scheduler;
            None: a cluster on this machine, for as long as it takes.
        quiet: no progress. plan: runs to fly in the place of the grid. scenario: what the grid is about, a
            file; by default the paper's. Every other one needs a folder of its own, and flies other seeds, from
            `grid.FRESH_SEED` on.

    Raises:
        BadInput: an unknown experiment or backend, or a folder that cannot be written.
        RunFailed: interrupted, disk full, or a run whose process died twice; what was finished is kept, and the
            same call goes on from there.
    """
    unknown = sorted((only or set()) - set(EXPERIMENTS))
    if unknown:
        raise BadInput(f"no experiment is called {', '.join(unknown)}; there are {', '.join(EXPERIMENTS)}")
    if seeds < 1:
        raise BadInput(f"{seeds} seeds: at least one")
    table = list(wanted(seeds, scenario=scenario) if plan is None else plan)
    with terminable(out), workers(backend, scheduler, jobs) as available:
        store = Store(out, version())
        finished = store.finished()
        missing = to_do([run for run in table if only is None or run.point.experiment in only], finished)

        def keep(run: Wanted, raw: bytes) -> None:
            store.add(raw)
            done(run)

        try:
            with _reports(missing, quiet) as done:
                runner.run(execute, missing, available, keep)
        except WorkerDied as error:
            names = ", ".join(sorted({f"{run.point.experiment} {run.scenario.method}" for run in error.tasks}))
            raise RunFailed(
                f"a process died twice on one of: {names}; the rest is kept, repeat the command to go on"
            ) from error
    results = tables(_rows(table, store.finished() if missing else finished))
    for name in ("runs", "series", "trajectories", "weights"):
        store.save(name, getattr(results, name))
    if not quiet:
        Console(stderr=True).print(f"{results.runs.num_rows} runs in the table, {results.diverged} of them diverged")
    return results


def to_do(table: Sequence[Wanted], finished: dict[str, StoredRun]) -> list[Wanted]:
    """The missing runs, each once even if several experiments share it, the longest first."""
    missing: dict[str, Wanted] = {}
    for run in table:
        earlier = finished.get(run.key)
        # A run kept without what an experiment shows of it is flown again; the first to want it decides otherwise.
        if (
            earlier is not None
            and (earlier.series is not None or not _kept(run)[0])
            and (earlier.trace or not run.traced)
        ):
            continue
        before = missing.get(run.key)
        if before is None or _kept(run) > _kept(before):
            missing[run.key] = run
    return sorted(missing.values(), key=lambda run: -work(run))


def work(run: Wanted) -> float:
    """Estimated time of a run, s."""
    ticks = 0.0
    for flown in filter(None, (run.training, run.scenario)):
        once, more = _COST.get(Method(flown.method), _COST_OF_OTHERS)
        ticks += flown.max_ticks * (once + more * flown.uavs)
    return ticks * 1e-6


def _kept(run: Wanted) -> tuple[bool, bool]:
    return EXPERIMENTS[run.point.experiment][1], run.traced


def execute(run: Wanted) -> bytes:
    """Fly one run and return the content of its file.

    Raises:
        RunFailed: the flight failed by a defect; the message names the run.
    """
    try:
        models = None if run.training is None else fly(run.training).models
        flown = fly(run.scenario, models=models, traced=run.traced)
        return encode([stored(run.key, scalars(flown), flown.record, _kept(run)[0])], version())
    except MeanflockError:
        raise
    except Exception as error:
        point = run.point
        where = f"{point.experiment} {point.flown.method} {point.setting}".strip()
        raise RunFailed(f"{where}, seed {run.seed}: {error!r}") from error


def scalars(flown: FlownRun) -> dict[str, Any]:
    """The columns of runs.parquet that depend on the run alone."""
    summary, radio = flown.summary, flown.summary["radio"]
    learns = Method(flown.scenario.method).learns_value
    result = {
        name: summary[name]
        for name in (
            "ticks", "sim_time_s", "arrived", "lost", "t_avg_s", "t_max_s", "energy_mean_J", "energy_std_J",
            "energy_end_mean_J", "energy_end_std_J", "phi_A", "phi_C", "phi_C_distinct", "collisions",
            "collisions_at_ticks", "speed_max_m_s", "speed_mean_m_s", "distance_mean_m", "rounds", "hjb_residual_max",
            "fpk_residual_max", "weight_spread_final", "trajectory_sha256",
        )
    }  # fmt: skip
    if not learns:
        result["hjb_residual_max"] = result["weight_spread_final"] = None
    result |= {f"bits_{name}": bits for name, bits in summary["payload_bits"].items()}
    result |= {
        name: radio[name]
        for name in (
            "sent", "delivered", "outages", "outage_rate", "outage_rate_theory", "latency_slots_mean",
            "latency_slots_mean_theory", "airtime_s",
        )
    }  # fmt: skip
    traffic = radio["traffic"]
    result |= {
        "uplink_sent": traffic["uplink"]["sent"],
        "uplink_outage_rate": traffic["uplink"]["outage_rate"],
        "uplink_outage_rate_theory": traffic["uplink"]["outage_rate_theory"],
        "broadcast_outage_rate": traffic["broadcast"]["outage_rate"],
        "state_outage_rate": traffic["state"]["outage_rate"],
    }
    return result | flown.record.scalars


def _rows(
    table: Sequence[Wanted], finished: dict[str, StoredRun]
) -> Iterator[tuple[dict[str, Any], StoredRun, bool, bool]]:
    for run in table:
        earlier = finished.get(run.key)
        if earlier is None:
            continue
        flown = run.scenario
        coordinates = {
            "experiment": run.point.experiment,
            "method": str(flown.method),
            "uavs": flown.uavs,
            "period": flown.period_ticks if plan_of(flown).declared.is_federated else None,
            "sigma": flown.wind.sigma,
            "setting": run.point.setting,
            "seed": run.seed,
            "trained": run.point.training is not None,
        }
        yield coordinates, earlier, _kept(run)[0], run.traced


@contextmanager
def _reports(missing: Sequence[Wanted], quiet: bool) -> Iterator[Callable[[Wanted], None]]:
    """A progress line with the number of finished runs and the time left."""
    bar = Progress(
        TextColumn("[bold]flying"),
        BarColumn(bar_width=32),
        TextColumn("{task.fields[runs]} of {task.fields[total_runs]} runs"),
        TextColumn("{task.fields[last]}"),
        TimeRemainingColumn(),
        console=Console(stderr=True),
        disable=quiet or not missing,
        transient=True,
    )
    task = bar.add_task("", total=sum(map(work, missing)), runs=0, total_runs=len(missing), last="")
    flown = 0

    def done(run: Wanted) -> None:
        nonlocal flown
        flown += 1
        bar.update(task, advance=work(run), runs=flown, last=f"{run.point.experiment} {run.scenario.method}")

    with bar:
        yield done
