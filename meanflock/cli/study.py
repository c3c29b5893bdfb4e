"""Commands that fly many times: compare, sweep, paper."""

import sys
from collections.abc import Mapping
from contextlib import redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import meanflock
from meanflock.cli import completion
from meanflock.cli.arguments import (
    PATH,
    load_scenario,
    number_option,
    out_option,
    quiet_option,
    report,
    scenario_arguments,
)
from meanflock.cli.study_arguments import (
    SEEDS,
    ResultsOptions,
    WorkersOptions,
    keys_or_list,
    lists,
    names,
    progress_of,
    results_options,
    scenario_option,
    seeds_option,
    store_in,
    workers_options,
)
from meanflock.swarm.errors import BadInput

if TYPE_CHECKING:
    from meanflock.swarm.scenario import Scenario


@click.command()
@click.argument("methods", nargs=-1, required=True, metavar="METHOD…", shell_complete=completion.controllers)
@scenario_option
@scenario_arguments("uavs", "seed", "duration", "settings", "radio", "learner", "until", "plugin")
@seeds_option
@workers_options
@click.option("--record", is_flag=True, help="Record the flights of the first seed side by side, in OUT/compare.rrd.")
@out_option("out/compare")
@results_options
@quiet_option
def compare(
    methods: tuple[str, ...],
    file: Path | None,
    seeds: int | None,
    workers: WorkersOptions,
    record: bool,
    out: Path,
    quiet: bool,
    wanted: ResultsOptions,
    **given: Any,
) -> None:
    """Compare controllers over the same seeds.

    Prints a table of means and which are significantly best. Writes it as CSV, LaTeX and figures with 95 % intervals, a
    table with a row for each flight and one with a row for each round, and study.json, from which `meanflock study
    rerun` flies it again. Repeat an interrupted command to fly only what is missing.

    \b
    Example: meanflock compare hjb mfgfl-hf --seeds 4 --duration 200
    """
    from meanflock.studies import swept

    swept.refuse_setting("method", given["settings"], "is what is compared")
    scenarios: dict[tuple[Any, ...], Scenario] = {}
    for method in names(methods):
        one = load_scenario(file, method=method, **given)
        swept.add_point(scenarios, swept.point_of(("method",), (), one), one)
    if record:  # before anything flies, for Rerun may not be installed; it takes a third of a second to load
        from meanflock.studies import side_by_side
        from meanflock.studies.runner import terminable
    _fly("compare", ("method",), scenarios, seeds or SEEDS, workers, out, quiet, wanted)
    if record:
        with terminable(out):
            side_by_side.record({method: flown for (method,), flown in scenarios.items()}, out / "compare.rrd")
            report([out / "compare.rrd"])


@click.command(cls=lists("--methods", "--learners"))
@click.argument("swept", nargs=-1, required=True, metavar="KEY=V1,V2…", shell_complete=keys_or_list)
@click.option(
    "--methods",
    multiple=True,
    metavar="NAME…",
    help="Controllers to sweep with.  [default: the scenario's]",
    shell_complete=completion.controllers,
)
@click.option(
    "--learners",
    multiple=True,
    metavar="FILE.py|NAME…",
    help="Learners to sweep with, as key training.learner.",
    shell_complete=completion.learners,
)
@scenario_option
@scenario_arguments("uavs", "seed", "duration", "settings", "radio", "learner", "until", "plugin")
@seeds_option
@workers_options
@out_option("out/sweep")
@results_options
@quiet_option
def sweep(
    swept: tuple[str, ...],
    methods: tuple[str, ...],
    learners: tuple[str, ...],
    file: Path | None,
    seeds: int | None,
    workers: WorkersOptions,
    out: Path,
    quiet: bool,
    wanted: ResultsOptions,
    settings: tuple[str, ...],
    **given: Any,
) -> None:
    """Compare several values of one scenario key, or of several.

    Several keys are a grid: all combinations of their values, the methods and the learners fly. Prints a table of means
    and which are significantly best. Writes it as CSV, LaTeX and figures with 95 % intervals, a table with a row for
    each flight and one with a row for each round, and study.json, from which `meanflock study rerun` flies it again.
    Repeat an interrupted command to fly only what is missing.

    \b
    Example:
      meanflock sweep wind.sigma=0.1,0.3 uavs=9,25 --methods hjb mfgfl-hf
    """
    from meanflock.settings import learner_named
    from meanflock.studies.swept import Grid, add_point, point_of, refuse_setting

    with redirect_stdout(sys.stderr):  # what plug-ins print is not what the command says
        given_keys = Grid.parse(swept)
        grid = given_keys.with_learners([learner_named(learner, "--learners") for learner in names(learners)])
    of_key = {"method": {"--methods": ", ".join(methods) or None}, "seed": {"--seed": given["seed"], "--seeds": seeds}}
    for varied in grid.keys:
        varied.check(of_key.get(varied.key, {f"--{varied.key}": given.get(varied.key)}), settings)
    if methods:
        refuse_setting("method", settings, "is what --methods names")
    flown_by: list[str | None] = [*dict.fromkeys(names(methods))] or [None]
    keys = tuple(varied.key for varied in grid.keys)
    named = keys if grid.has_methods else (*keys, "method")
    scenarios: dict[tuple[Any, ...], Scenario] = {}
    for point in grid.points():
        for name in flown_by:
            one = load_scenario(file, (*settings, *grid.settings(point)), method=name, **given)
            add_point(scenarios, point_of(named, point, one), one)
    given_keys.check_values()  # after the scenarios, which know unknown keys
    _fly("sweep", named, scenarios, 1 if "seed" in keys else seeds or SEEDS, workers, out, quiet, wanted)


def _fly(
    verb: str,
    columns: tuple[str, ...],
    scenarios: "Mapping[Any, Scenario]",
    seeds: int,
    workers: WorkersOptions,
    out: Path,
    quiet: bool,
    wanted: ResultsOptions,
) -> None:
    """Fly all runs that `out` does not have; print the tables of the study, and write its files.

    Args:
        columns: names of the varied values. wanted: what results the options ask for.
    """
    from meanflock.cli.study_results import StudyResults
    from meanflock.launch import memory
    from meanflock.studies import before_take_off, study, study_file
    from meanflock.studies.runner import terminable

    if workers.backend == "processes":  # a cluster has a memory of its own
        memory.check(scenarios.values())
    points = {at: study.seeded(one, seeds) for at, one in scenarios.items()}
    results = StudyResults(verb, columns, points, wanted)
    study_file.check_folder(out, points)
    before_take_off.warn(columns, scenarios)
    results.warn()
    with terminable(out):
        with workers.start() as jobs, store_in(out) as store, progress_of(verb, quiet) as progress:
            flown = study.fly_all(points, jobs, progress, store)
        results.tell(flown)
        report(results.write(flown, out))


@click.command()
@number_option("--seeds", "K", 30, "Flights of each point; 2 for a quick look.")
@click.option(
    "--only",
    multiple=True,
    metavar="FIG",
    help="fig2 … fig8, map or exchanged: fly only what it needs; repeatable.",
)
@click.option(
    "--scenario",
    "name",
    metavar="NAME",
    help="Judge this scenario instead: paper-slow, paper-printed, paper-exchanged or a file.  [default: paper]",
)
@workers_options
@click.option("--out", type=PATH, metavar="DIR", help="Where results are written.  [default: out/paper, or out/NAME]")
@quiet_option
def paper(
    seeds: int,
    only: tuple[str, ...],
    name: str | None,
    workers: WorkersOptions,
    out: Path | None,
    quiet: bool,
) -> None:
    """Repeat the paper's experiments and test its claims.

    Writes figures, tables, and a verdict for each claim. Repeat an interrupted command to fly only what is missing.

    \b
    Example: meanflock paper --seeds 2 --out out/paper
    """
    from meanflock.launch.doctor import tell_if_slow
    from meanflock.studies.runner import terminable
    from meanflock.swarm import scenario

    _find_research()
    from research.reproduction.experiments import run_grid
    from research.reproduction.figures import FLOWN_FOR, chosen, draw
    from research.reproduction.measure import measured
    from research.reproduction.report import counts, write_report
    from research.reproduction.verdict import evaluate

    experiments = set().union(*(FLOWN_FOR[figure] for figure in chosen(only))) if only else None
    file = None if name in (None, "paper") else Path(str(name))
    base = scenario.load(file)
    out = out or Path("out") / (file.stem if file else "paper")
    tell_if_slow()
    with terminable(out):
        results = run_grid(out, seeds, experiments, *workers, quiet, scenario=file)
        with progress_of("theory", quiet) as progress:
            theory = measured(out, jobs=workers.jobs, progress=progress, scenario=base)
        records = evaluate(results, theory)
        draw(results, out / "figures", only)
        paths = write_report(results, records, out, theory)
    for verdict, number in counts(records).items():
        click.echo(f"{verdict}: {number}", err=True)
    report(paths)


def _find_research() -> None:
    """Make the package `research` of a checkout importable.

    Raises:
        BadInput: there is no such folder.
    """
    checkout = Path(meanflock.__file__).resolve().parents[1]
    if not (checkout / "research" / "__init__.py").is_file():
        raise BadInput(
            "paper: the folder `research` is missing; it is in the source of meanflock, not in the installed "
            "package. Get the source, install it with `pip install -e '.[ground]'`, and repeat the command"
        )
    if str(checkout) not in sys.path:
        sys.path.append(str(checkout))  # worker processes inherit it
