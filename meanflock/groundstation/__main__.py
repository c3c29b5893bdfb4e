"""`python -m meanflock.groundstation`: records a swarm that was started otherwise."""

import json
import re
import time
from argparse import Namespace
from contextlib import ExitStack, suppress
from datetime import datetime
from pathlib import Path
from typing import Any

import meanflock.swarm.one_thread  # noqa: F401  # first: NumPy reads the variables once
from meanflock.swarm.errors import needed

with needed("the ground station", "ground"):
    from meanflock.launch.options import FlightOptions, records
    from meanflock.launch.outputs import Outputs
    from meanflock.launch.station import RecordingStation
    from meanflock.net import keys
    from meanflock.net.access import STATION, Address
    from meanflock.net.bus import Bus
    from meanflock.net.client import connected
    from meanflock.net.process import Interrupted, flag, identity, main, parser
    from meanflock.net.session import ZenohBus
    from meanflock.results.run_folder import SCENARIO, SUMMARY, RunFolder, go_on, lost_everyone
    from meanflock.results.timeseries_file import Past, past
    from meanflock.swarm import durable, logs, paths, scenario
    from meanflock.swarm.errors import BadInput, BusError, RunFailed
    from meanflock.swarm.scenario import Scenario
    from meanflock.swarm.wire import control
    from meanflock.swarm.wire.messages import Join, Welcome
    from meanflock.worldsim.summary import every_uav_was_lost

_ASK_S = 2.0
LATEST = "latest"


def _run() -> None:
    options = parser(
        "groundstation",
        "Records a swarm that was started otherwise, and prints its summary.",
        "python -m meanflock.groundstation --run test --out runs",
    )
    flag(options, "--out", "runs", "where run folders are made", metavar="DIR")
    flag(options, "--rerun", "127.0.0.1:9876", "where a live viewer connects; empty: nowhere", metavar="[HOST:]PORT")
    flag(options, "--resume", "", "run folder to continue; `latest`: that of this flight, if any", metavar="RUN")
    given = options.parse_args()
    logs.start(given.log_format, run=given.run, node=STATION)
    serve = Address.parse("--rerun", given.rerun) if given.rerun else None
    interrupted = Interrupted()
    bus = _connect(given, interrupted)
    try:
        # First, so that the station notices a world that ends while the recorder is still loading.
        bus.watch(keys.alive(keys.check_run(given.run), "world", "world"))
        welcome = _ask(bus, given, interrupted)
        flown = scenario.decode(welcome.scenario)
        record = records(None, "", quiet=False)
        with ExitStack() as stack:
            out = paths.given(given.out)
            folder, so_far = _folder(given.resume, out, given.run, flown, welcome.tick) or (
                stack.enter_context(durable.new_folder(out, f"{given.run}-{datetime.now():%Y%m%d-%H%M%S}")),
                None,
            )
            flight = FlightOptions(out=folder.parent, record=record, serve=serve if record else None, quiet=True)
            outputs = stack.enter_context(Outputs(flown, folder.name, flight, so_far))
            first_block = so_far.next_block if so_far is not None else None
            station = RecordingStation(
                bus,
                given.run,
                outputs.sinks,
                first_block=first_block,
                uavs=flown.uavs,
                nodes=flown.nodes,
                dimensions=flown.dimensions,
            )
            outputs.summary = _listen(bus, station, outputs.folder, given, interrupted)
        print(json.dumps(outputs.summary, indent=1), flush=True)
        if every_uav_was_lost(flown, outputs.summary):
            raise RunFailed(lost_everyone(folder))
    finally:
        bus.close()


def _listen(
    bus: Bus, station: RecordingStation, folder: RunFolder, given: Namespace, interrupted: Interrupted
) -> dict[str, Any]:
    """Record until the summary arrives. Zenoh reopens a lost session, and the world then sends the missed blocks."""
    lost: float | None = None
    while station.summary is None:
        if interrupted:
            raise RunFailed(f"interrupted; {folder.path} has the recorded part")
        if lost is not None and time.monotonic() - lost > given.wait:
            raise RunFailed(
                "the world is gone: it ended (its log says why), was killed (perhaps because it took too much memory), "
                f"or cannot be reached; {folder.path} has the part that was flown; {go_on(folder.path)}"
            )
        delivery = bus.receive(0.2)
        if delivery is None:
            continue
        if delivery.kind == "gone":
            lost = time.monotonic()
        elif delivery.kind == "alive" and lost is not None:
            lost = None
            if _ask(bus, given, interrupted).tick < folder.last_tick:
                raise RunFailed(f"another world has taken its place; {folder.path} has the flight of the first")
        else:
            station.handle(delivery)
    return station.summary


def _folder(wanted: str, out: Path, run: str, flown: Scenario, tick: int) -> tuple[Path, Past] | None:
    """The folder to continue for a flight that has reached `tick`, and the rows in it; None: a new folder is needed."""
    if wanted == LATEST:
        return _of_this_flight(out, run, flown, tick)
    if not wanted:
        return None
    folder = paths.given(wanted)
    if not (folder / SCENARIO).is_file() or scenario.load(folder / SCENARIO).sha256() != flown.sha256():
        raise BadInput(f"--resume {folder}: not a run of the scenario that is flown; leave --resume out")
    return folder.resolve(), past(folder)


def _of_this_flight(out: Path, run: str, flown: Scenario, tick: int) -> tuple[Path, Past] | None:
    """The newest folder of a run of that name without a summary, if it is of this scenario and has no more ticks than
    this flight, so that it is not of an earlier flight.
    """
    named = re.compile(re.escape(run) + r"-\d{8}-\d{6}(-\d+)?")
    found = [path for path in out.glob("*") if named.fullmatch(path.name) and not (path / SUMMARY).exists()]
    with suppress(BadInput):  # of another version, or killed before it wrote anything
        if found and scenario.load((folder := max(found)) / SCENARIO).sha256() == flown.sha256():
            so_far = past(folder)
            if so_far.rows.num_rows <= tick + 1:
                return folder.resolve(), so_far
    return None


def _connect(given: Namespace, interrupted: Interrupted) -> Bus:
    """Open a session with the world, and wait for the world."""
    who = identity(given.tls, STATION)
    end = time.monotonic() + given.wait
    try:
        return connected(lambda left_s: ZenohBus.client(given.endpoint, left_s, who), end, interrupted.__bool__)
    except BusError:
        if interrupted:
            raise RunFailed("interrupted while waiting for the world; nothing was recorded") from None
        raise


def _ask(bus: Bus, given: Namespace, interrupted: Interrupted) -> Welcome:
    """Ask the world for the scenario and the current tick."""
    run, wait_s = given.run, given.wait
    request = control.encode(Join("station", 0))
    for _ in range(max(1, round(wait_s / _ASK_S))):
        if interrupted:
            raise RunFailed("interrupted while waiting for the world's answer")
        answer = bus.ask(keys.join(run, keys.requested_name("station")), request, _ASK_S)
        if answer is not None:
            welcome = control.decode(answer)
            if isinstance(welcome, Welcome) and welcome.run == keys.fingerprint(run):
                return welcome
            raise BusError(f"the world of run {run!r} answered with {type(welcome).__name__}")
    raise BusError(f"no world of run {run!r} answered within {wait_s:.0f} s")


if __name__ == "__main__":
    main(_run)
