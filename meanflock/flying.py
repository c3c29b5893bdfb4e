"""`mf.fly`: one flight in this process and thread."""

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from meanflock.channel.outlook import warn_of_lost_models
from meanflock.federation.plan import plan_of
from meanflock.launch import memory
from meanflock.launch.engine import Engine
from meanflock.launch.station import StoredTelemetry, WarningNotes
from meanflock.progress import Progress, checked_progress
from meanflock.results.groups import run_name
from meanflock.results.scenario_name import scenario_name
from meanflock.results.series import check_reports
from meanflock.runs import Run
from meanflock.settings import learner_named, load_plugins, scenario_of, with_settings
from meanflock.swarm import paths, threads
from meanflock.swarm.errors import BadInput, PluginFailed, RunFailed
from meanflock.swarm.scenario import Scenario
from meanflock.worldsim.reporting import BlockSink

if TYPE_CHECKING:
    from meanflock.launch.outputs import Outputs


@with_settings
@threads.limited()
def fly(
    scenario: str | Path | Scenario | None = "paper",
    *,
    method: str | type | None = None,
    learner: str | Path | type | None = None,
    uavs: int | None = None,
    seed: int | None = None,
    duration: float | None = None,
    plugin: str | Path | Sequence[str | Path] | None = None,
    out: str | Path | None = None,
    record: bool = False,
    progress: Progress | None = None,
    **settings: Any,
) -> Run:
    """Flies a scenario in this process. Works in any thread; uses no network, process or signal handler.

    Args:
        scenario: the name of a shipped scenario, a TOML file, or a Scenario.
        method: the controller, by name or as a class.
        learner: a learner that trains while UAVs fly, by name, file or class; the method must share no model.
        uavs: number of UAVs.
        seed: seed of all random numbers.
        duration: longest simulated time, s.
        plugin: one or several files with plug-ins.
        out: folder in which the run creates its run folder, as `meanflock run` does; None: nothing is written.
        record: also write a Rerun recording there.
        progress: called every hundred ticks with the ticks flown and the largest number of ticks.
        settings: any dotted scenario key, as in `**{"wind.sigma": 0.2}`. A key that names a plug-in may be its class.

    Returns:
        The run: `.summary`, `.states`, `.events`, `.frame()`. UAVs whose controller failed are counted in
        `.summary["lost"]`, and `.events` says why, even if every UAV is lost.

    Raises:
        BadInput: an argument cannot be used; nothing was flown.
        RunFailed: the flight failed.
    """
    tell = checked_progress(progress)
    load_plugins(plugin)
    options: dict[str, Any] = {"method": method, "uavs": uavs, "seed": seed, "duration": duration}
    if learner is not None:
        options["training.learner"] = learner_named(learner)
    flown = scenario_of(scenario, settings, **options)
    with ExitStack() as stack:
        flight = prepared(flown, out, record, stack, scenario_name(scenario))
        try:
            for tick in flight.engine.fly():
                if tick % 100 == 0:
                    tell(tick, flown.max_ticks)
            return flight.finish()
        except PluginFailed as error:
            failure = error
    raise flight.failed(failure) from failure


class Prepared(NamedTuple):
    """A flight before take-off: the engine, the memory of its telemetry, and the files that it writes, if any."""

    scenario: Scenario
    engine: Engine
    memory: StoredTelemetry
    outputs: "Outputs | None"

    def failed(self, failure: PluginFailed) -> RunFailed:
        """The error of a flight whose files are complete up to a failure, with what its folder has, if it has one."""
        return failure if self.outputs is None else RunFailed(f"{failure}\n{self.outputs.what_there_is}")

    def finish(self) -> Run:
        """End the flight."""
        summary = self.engine.finish()
        folder = None
        if self.outputs is not None:
            self.outputs.summary = summary
            folder = self.outputs.folder.path
        return Run(self.scenario, summary, self.memory.blocks, folder)


def prepared(
    flown: Scenario,
    out: str | Path | None,
    record: bool,
    stack: ExitStack,
    mission: str | None,
    *,
    is_stepped: bool = False,
) -> Prepared:
    """Prepare a flight whose files are complete when `stack` is closed. `mission`: name of the scenario, if it has one.

    A stepped flight has one agent, and nobody but its caller resumes it.

    Raises:
        BadInput: the scenario or the folder cannot be used, or the files would not fit on the disk.
    """
    if record and out is None:
        raise BadInput("record=True: name the folder for it, out=…")
    flown = plan_of(flown).given
    check_reports(plan_of(flown))
    memory.check([flown])
    warn_of_lost_models(flown)
    outputs = None
    run_id = run_name(flown, mission)
    telemetry = StoredTelemetry()
    sinks: list[BlockSink] = [telemetry]
    if out is None:
        sinks.append(WarningNotes())
    else:
        from meanflock.launch.options import FlightOptions, records
        from meanflock.launch.outputs import Outputs
        from meanflock.launch.run import new_run
        from meanflock.results import disk

        record = record and records(True, "record=True", quiet=True)
        out = paths.given(out)
        disk.check(flown, out, record, disk.OF_PYTHON)
        run_id = stack.enter_context(new_run(flown, out, mission)).name
        outputs = stack.enter_context(
            Outputs(flown, run_id, FlightOptions(out, record=record, quiet=True, mission=mission))
        )
        sinks += outputs.sinks
    engine = Engine(flown, run_id, sinks=sinks, threads=1 if is_stepped else None, is_resumable=not is_stepped)
    return Prepared(flown, engine, telemetry, outputs)
