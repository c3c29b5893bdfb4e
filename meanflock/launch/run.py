"""One run, from a scenario to a finished folder: in this process, or on a swarm of processes."""

import time
from contextlib import AbstractContextManager, ExitStack, nullcontext, suppress
from dataclasses import dataclass, replace
from datetime import datetime
from logging import WARNING
from pathlib import Path
from typing import TYPE_CHECKING, Any

from meanflock.federation.plan import plan_of
from meanflock.launch import doctor
from meanflock.launch.memory import learner_memory
from meanflock.launch.options import FlightOptions
from meanflock.net.access import STATION, Address, Identity, free, secured
from meanflock.net.process import Interrupted
from meanflock.results.groups import run_name
from meanflock.swarm import durable, logs
from meanflock.swarm import scenario as scenarios
from meanflock.swarm.declared import NO_LEARNER
from meanflock.swarm.errors import BadInput, BusError, PluginFailed, ProcessDied, RunFailed, needed
from meanflock.swarm.scenario import Scenario
from meanflock.worldsim.checkpoint import Resumption
from meanflock.worldsim.steering import LOCKSTEP
from meanflock.worldsim.summary import every_uav_was_lost

if TYPE_CHECKING:
    from meanflock.launch.outputs import Outputs
    from meanflock.launch.processes import Swarm
    from meanflock.launch.resume import Back
    from meanflock.launch.station import RecordingStation
    from meanflock.net.session import ZenohBus
    from meanflock.worldsim.reporting import BlockSink

_CONNECT_S = 60.0
_STEP_S = 0.2  # between two looks at the processes
_JOIN_S = 60.0
_LAST_WORDS_S = 15.0
_ON_ITS_WAY_S = 2.0  # after the world has ended
_SLOW_BYTES_S = 10e6  # of the replies of a process with many UAVs
_OVERDUE = "interrupted; the flight is still being completed, or a plug-in hangs: Ctrl-C again ends it at once"
_LOST_NODES_S = 2.0  # a lost node may be stopped, and is then killed


@dataclass(frozen=True)
class EndedRun:
    """A run that ended: the scenario that flew, its folder and its summary."""

    scenario: Scenario
    folder: Path
    summary: dict[str, Any]


class RunStopped(RunFailed):
    """A run that was interrupted or lost a process, or a plug-in of it failed.

    `ended` has the part that was flown; its summary may be empty.
    """

    def __init__(self, text: str, ended: EndedRun) -> None:
        super().__init__(text)
        self.ended = ended


def new_run(scenario: Scenario, parent: Path, mission: str | None = None) -> AbstractContextManager[Path]:
    """Context with the folder of a new run in `parent`, named by time and `run_name`; see `durable.new_folder`."""
    return durable.new_folder(parent, f"{datetime.now():%Y%m%d-%H%M%S}-{run_name(scenario, mission)}")


def fly(scenario: Scenario, options: FlightOptions, back: "Back | None" = None) -> EndedRun:
    """Fly a scenario and write its run folder; with `back`, continue in the folder of an unfinished run.

    Raises:
        BadInput: an option cannot be used; nothing was written.
        RunFailed: a process crashed, a plug-in failed, or the run was interrupted; the folder has the part that was
            flown. It is a `RunStopped` if the outputs are complete.
    """
    scenario = plan_of(scenario).given
    folder = new_run(scenario, options.out, options.mission) if back is None else nullcontext(back.folder)
    with Interrupted() as interrupted, folder as path:
        interrupted.at_once = lambda: _given_up(path)
        return _fly(scenario, path.name, options, back, interrupted)


def _given_up(folder: Path) -> str:
    """Remove a run folder that is still empty; returns a text about a run that was interrupted before its outputs."""
    with suppress(OSError):  # it has files
        folder.rmdir()
    return "interrupted twice, before take-off; repeat the command"


def _fly(
    scenario: Scenario, run_id: str, options: FlightOptions, back: "Back | None", interrupted: Interrupted
) -> EndedRun:
    if options.log_format is not None:
        logs.start(options.log_format, run=run_id, node="in-process" if options.in_process else STATION)
    for name, given in (("--tls", options.tls), ("--endpoint", options.endpoint)):
        if options.in_process and given is not None:
            raise BadInput(f"{name} {given}: a run in one process has no links; leave out {name}, or --in-process")
    if options.tls is not None:
        with needed("--tls", "ground"):  # a library that most runs need not load
            from meanflock.launch import certs

        certs.check(options.tls, scenario.uavs, options.uavs_per_process)
        if any(uav % options.uavs_per_process for uav in plan_of(scenario).node_firsts(options.uavs_per_process)):
            raise BadInput(
                f"--uavs-per-process {options.uavs_per_process}: with --tls every process has the certificate of its "
                "first UAV, a multiple of that number, and the `[[groups]]` begin at others; take 1"
            )
    if options.endpoint is not None:
        identity = None if options.tls is None else Identity(options.tls, STATION)
        options = replace(options, endpoint=_told(options.endpoint, free(secured(options.endpoint, identity))))
    if options.metrics is not None:
        options = replace(options, metrics=options.metrics.free("--metrics"))
    if options.steer is not None:
        options = replace(options, steer=_steered(options))
    doctor.tell_if_slow()
    start = None if back is None else back.start
    failure: RunFailed | None = None
    with ExitStack() as stack:
        # First, because the world begins beside the outputs, whose libraries take as long to load.
        swarm = None if options.in_process else stack.enter_context(_begun(scenario, run_id, options, start))
        from meanflock.launch.outputs import Outputs

        outputs = stack.enter_context(Outputs(scenario, run_id, options, None if back is None else back.past))
        interrupted.at_once = outputs.give_up
        if options.in_process:
            interrupted.overdue = _OVERDUE
        try:
            if swarm is None:
                outputs.summary = _in_process(scenario, run_id, options, outputs.sinks, interrupted, start)
            else:
                with swarm:
                    outputs.summary = _processes(swarm, scenario, run_id, options, outputs, interrupted, start)
        except (PluginFailed, ProcessDied) as error:
            failure = error
    ended = EndedRun(scenario, outputs.folder.path, outputs.summary)
    if failure is not None or interrupted:
        reason = "interrupted; " if failure is None else f"{failure}\n"
        raise RunStopped(f"{reason}{outputs.what_there_is}", ended) from failure
    return ended


def _told(asked: str, endpoint: str) -> str:
    """The endpoint of the world; if it is not the one that was asked for, a line says which port it has."""
    if asked.endswith(":0"):
        logs.show(f"the world listens at {endpoint}")
    return endpoint


def _steered(options: FlightOptions) -> Address:
    """The free port at which a flight is steered.

    Raises:
        BadInput: the port is taken, or the flight does not follow the wall clock.
    """
    assert options.steer is not None
    if options.realtime is None:
        raise BadInput(LOCKSTEP)
    with needed("--steer", "mavlink"):
        import meanflock.bridge.mavlink  # noqa: F401  # the world needs it, perhaps in a process of its own
    address = options.steer.free("--steer", datagrams=True)
    if not options.quiet:
        logs.show(f"MAVLink clients steer at udp {address}")
    return address


def _in_process(
    scenario: Scenario,
    run_id: str,
    options: FlightOptions,
    sinks: "list[BlockSink]",
    interrupted: Interrupted,
    start: Resumption | None,
) -> dict[str, Any]:
    from meanflock.launch.engine import Engine

    rows = options.uavs_per_process if options.uavs_per_process > 1 else None
    with ExitStack() as stack:
        port = None
        if options.steer is not None:
            from meanflock.bridge.steering_port import SteeringPort  # it loads pymavlink

            port = stack.enter_context(SteeringPort(options.steer, scenario.uavs, scenario.dt))
        engine = Engine(
            scenario, run_id, uavs_per_node=rows, sinks=sinks, realtime=options.realtime, steer=port, resume=start
        )
        if options.metrics is not None:
            from meanflock.net.exporter import Exporter, exported  # a library that most runs need not load

            exporter = Exporter(engine.world, run_id, "in-process", engine.watch)
            logs.show(f"metrics at {stack.enter_context(exported(exporter, options.metrics))}")
            engine.add_sink(exporter)
        for _ in engine.fly():
            if interrupted:
                break
        return engine.finish()


def _lease_s(scenario: Scenario, rows: int) -> float | None:
    """How long a link of a process with so many UAVs may be silent: longer if its replies are long, because the world
    reads one after the other; None: the default."""
    from meanflock.net.session import LEASE_S

    reply_s = min(rows, scenario.uavs) * learner_memory(scenario).uav_bytes / _SLOW_BYTES_S
    return None if reply_s < LEASE_S.default else min(LEASE_S.default + reply_s, LEASE_S.most)


def _begun(scenario: Scenario, run_id: str, options: FlightOptions, start: Resumption | None) -> "Swarm":
    """A swarm whose world is starting."""
    from meanflock.launch.processes import Swarm  # it loads Zenoh

    swarm = Swarm(run_id, options.endpoint, options.tls, options.log_format, options.forker)
    try:
        swarm.start_world(
            scenarios.toml_text(plan_of(scenario).scenario),
            wait_s=_JOIN_S,
            realtime=options.realtime,
            rows=options.uavs_per_process,
            resume=None if start is None else start.encode(),
            metrics=options.metrics,
            steer=options.steer,
            has_learner=scenario.training.learner != NO_LEARNER,
            lease_s=_lease_s(scenario, options.uavs_per_process),
        )
    except BaseException:
        swarm.close()
        raise
    return swarm


def _processes(
    swarm: "Swarm",
    scenario: Scenario,
    run_id: str,
    options: FlightOptions,
    outputs: "Outputs",
    interrupted: Interrupted,
    start: Resumption | None,
) -> dict[str, Any]:
    from meanflock.launch.station import RecordingStation

    outputs.kill = swarm.kill
    outputs.progress.say("starting processes")
    if options.metrics is not None and options.log_format is None:  # the world's log says so
        logs.show(f"metrics at http://{options.metrics}/metrics")
    if swarm.forks:  # they start at once, and would look in vain for a world that still loads
        _await_world(swarm, interrupted, outputs)
    if plan_of(scenario).declared.is_federated or scenario.faults:  # otherwise the station may come after the flight
        swarm.start_leaders(plan_of(scenario).leaders(0 if start is None else start.tick), _JOIN_S)
    swarm.start_agents(plan_of(scenario).node_firsts(options.uavs_per_process), options.uavs_per_process, _JOIN_S)
    _await_world(swarm, interrupted, outputs)
    bus = _connect(swarm, interrupted, outputs)
    try:
        outputs.progress.say("joining")
        first_block = 0 if start is None else start.block + 1
        station = RecordingStation(
            bus,
            run_id,
            outputs.sinks,
            first_block=first_block,
            uavs=scenario.uavs,
            nodes=scenario.nodes,
            dimensions=scenario.dimensions,
        )
        _listen(bus, station, swarm, interrupted, outputs)
    except BadInput as error:  # of a node that starts, or in flight
        _hear_the_end(bus, station, swarm)
        if outputs.folder.last_tick < 0:
            raise
        raise ProcessDied(str(error)) from error
    finally:
        bus.close()
    assert station.summary is not None
    some_lost = station.summary["nodes_lost"] > 0
    left = swarm.wait(_LOST_NODES_S if some_lost else _LAST_WORDS_S)
    if left and not some_lost:
        logs.note(
            f"the flight is complete, but not all processes ended within {_LAST_WORDS_S:g} s of it; "
            f"ended now: {', '.join(left)}",
            WARNING,
        )
    if not (interrupted or every_uav_was_lost(scenario, station.summary)):  # otherwise it ends with an error too
        swarm.check_ends()
    return station.summary


def _hear_the_end(bus: "ZenohBus", station: "RecordingStation", swarm: "Swarm") -> None:
    """Let the world end the flight now, and take the telemetry up to there."""
    swarm.interrupt()
    end = time.monotonic() + _LAST_WORDS_S
    while station.summary is None and time.monotonic() < end:
        delivery = bus.receive(0.05)
        if delivery is not None:
            station.handle(delivery)
        elif swarm.world_ended:
            return


def _await_world(swarm: "Swarm", interrupted: Interrupted, outputs: "Outputs") -> None:
    """Wait for the world in short steps, so that a world that cannot start is noticed at once."""
    end = time.monotonic() + _CONNECT_S
    while not swarm.others_can_join(_STEP_S):
        _look_after(swarm, interrupted, outputs, end)
    _look_after(swarm, interrupted, outputs, end)


def _connect(swarm: "Swarm", interrupted: Interrupted, outputs: "Outputs") -> "ZenohBus":
    end = time.monotonic() + _CONNECT_S
    while True:
        try:
            return swarm.connect(timeout_s=1.0)
        except BusError:
            _look_after(swarm, interrupted, outputs, end)


def _look_after(swarm: "Swarm", interrupted: Interrupted, outputs: "Outputs", end: float) -> None:
    """Notice an interrupt, processes that died, and that the time is up."""
    if interrupted:
        raise RunFailed(f"interrupted while the swarm was starting; {outputs.what_there_is}")
    swarm.check()
    if time.monotonic() > end:
        raise RunFailed(
            f"after {_CONNECT_S:g} s the world still cannot be reached: the machine is too busy, or something "
            "blocks its ports; see `meanflock doctor`"
        )


def _listen(
    bus: "ZenohBus", station: "RecordingStation", swarm: "Swarm", interrupted: Interrupted, outputs: "Outputs"
) -> None:
    asked = checked = ended = 0.0
    while station.summary is None:
        delivery = bus.receive(0.05)
        if delivery is not None:
            station.handle(delivery)
        now = time.monotonic()
        if interrupted and not asked:
            asked = now
            swarm.interrupt()
        if asked and now - asked > _LAST_WORDS_S:
            raise RunFailed(f"interrupted, the world did not answer any more; {outputs.what_there_is}")
        if not asked and now - checked > 0.1:
            checked = now
            swarm.check()
        if delivery is None and swarm.world_ended:  # only deliveries under way can still arrive
            ended = ended or now
            if now - ended > _ON_ITS_WAY_S:
                reason = "interrupted" if interrupted else "the world ended before this process had its last words"
                raise RunFailed(f"{reason}; {outputs.what_there_is}")
