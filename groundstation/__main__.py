"""`python -m groundstation`: a ground station of its own, for a swarm that something else started."""

import json
import re
from datetime import datetime
from pathlib import Path

from groundstation.results import SCENARIO, SUMMARY, Past, past
from groundstation.run import Desk, Options
from groundstation.station import Station
from swarm import codec, keys, logs, scenario
from swarm.address import Address
from swarm.errors import BadInput, BusError, RunFailed
from swarm.identity import STATION
from swarm.messages import Join, Welcome
from swarm.process import Interrupted, flag, identity, main, parser
from swarm.session import ZenohBus

_ASK_S = 2.0


def _run() -> None:
    options = parser(
        "groundstation",
        "Records a swarm that something else started, and prints its summary.",
        "python -m groundstation --run test --out runs",
    )
    flag(options, "--out", "runs", "folder of the run folders")
    flag(options, "--rerun", "127.0.0.1:9876", "where a live viewer connects; empty: nowhere")
    flag(
        options, "--resume", "", "run folder in which to go on; `latest`: the newest unfinished one of this run, if any"
    )
    given = options.parse_args()
    logs.start(given.log_format, run=given.run, node=STATION)
    serve = Address.parse("--rerun", given.rerun) if given.rerun else None
    interrupted = Interrupted()
    bus = ZenohBus.client(given.endpoint, given.wait, identity(given.tls, STATION))
    try:
        # Before anything is asked: a world that ends while the recorder is still loading is then not waited for.
        bus.watch(keys.alive(keys.check_run(given.run), "world", "world"))
        flown = _ask(bus, given.run, given.wait)
        folder, so_far = _folder(given.resume, Path(given.out), given.run, flown)
        with Desk(flown, folder.name, Options(out=folder.parent, serve=serve, quiet=True), so_far) as desk:
            first_block = so_far.next_block if so_far is not None else None
            station = Station(bus, given.run, desk.sinks, first_block=first_block, uavs=flown.uavs)
            while station.summary is None:
                delivery = bus.receive(0.2)
                if delivery is not None and delivery.kind == "gone":
                    raise RunFailed(f"the world is gone; {desk.folder.path} holds what was flown")
                if delivery is not None:
                    station.handle(delivery)
                if interrupted:
                    raise RunFailed(f"interrupted; {desk.folder.path} holds what was recorded")
            desk.summary = station.summary
        print(json.dumps(station.summary, indent=1), flush=True)
    finally:
        bus.close()


def _folder(wanted: str, out: Path, run: str, flown: scenario.Scenario) -> tuple[Path, Past | None]:
    """Where to record, and what is there already."""
    folder = Path(wanted)
    if wanted == "latest":
        named = re.compile(re.escape(run) + r"-\d{8}-\d{6}")
        found = [path for path in out.glob("*") if named.fullmatch(path.name) and not (path / SUMMARY).exists()]
        wanted = "" if not found else str(folder := max(found, key=lambda path: path.name))
    if not wanted:
        return out / f"{run}-{datetime.now():%Y%m%d-%H%M%S}", None
    if not (folder / SCENARIO).is_file() or scenario.load(folder / SCENARIO).sha256() != flown.sha256():
        raise BadInput(f"--resume {folder}: not a run of the scenario that is flown; leave --resume out")
    return folder.resolve(), past(folder)


def _ask(bus: ZenohBus, run: str, wait_s: float) -> scenario.Scenario:
    """What the world flies."""
    request = codec.encode(Join("station", 0))
    for _ in range(max(1, round(wait_s / _ASK_S))):
        answer = bus.ask(keys.join(run, keys.asker("station")), request, _ASK_S)
        if answer is not None:
            welcome = codec.decode(answer)
            if isinstance(welcome, Welcome) and welcome.run == keys.fingerprint(run):
                return scenario.decode(welcome.scenario)
            raise BusError(f"the world of run {run!r} answered with {type(welcome).__name__}")
    raise BusError(f"no world of run {run!r} answered within {wait_s:.0f} s")


if __name__ == "__main__":
    main(_run)
