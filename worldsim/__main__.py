"""`python -m meanflock.worldsim`: the world and channel emulator, and the router of the bus. Prints the summary."""

import json
import math
import os
import time
from contextlib import ExitStack
from pathlib import Path

import meanflock.swarm.one_thread  # noqa: F401  # first: NumPy reads the variables once
from meanflock.swarm.errors import needed

with needed("the world", "world"):
    from meanflock.federation.plan import plan_of
    from meanflock.net import access, keys
    from meanflock.net.access import WORLD, Address
    from meanflock.net.limits import Limits, Quotas
    from meanflock.net.members import MAX_LEADERS
    from meanflock.net.networked import MODE, NetworkedRun
    from meanflock.net.process import (
        Interrupted,
        end_with_launcher,
        flag,
        identity,
        launched,
        main,
        orphaned,
        parser,
        ready,
        seconds,
    )
    from meanflock.net.remote import RemoteCrew
    from meanflock.net.session import ZenohBus
    from meanflock.swarm import logs, scenario, threads
    from meanflock.swarm.errors import BadInput, RunFailed
    from meanflock.worldsim.checkpoint import Resumption
    from meanflock.worldsim.clocks import factor
    from meanflock.worldsim.steering import LOCKSTEP
    from meanflock.worldsim.summary import every_uav_was_lost

LINGER_S = 20.0  # wait for a recorder that is slow, or that is restarted
HURRIED_S = 5.0  # the same after an interrupt; a container engine sends SIGKILL after ten seconds
SEE_OFF_S = 2.0


def run() -> None:
    """Be this program, with the flags in `sys.argv`."""
    options = parser(
        "worldsim",
        "World and radio: waits for the nodes, flies the scenario, prints the summary.",
        "python -m meanflock.worldsim --run test --set uavs=4 --set method=hjb",
    )
    flag(options, "--scenario", "", "scenario file (TOML), or the name of a shipped one", metavar="SCENARIO")
    flag(options, "--barrier", "10", "how long a tick waits for a node", seconds("--barrier", 0.1), "SECONDS")
    flag(options, "--stations", "0", "ground stations that must listen before the first tick", int, "N")
    flag(options, "--realtime", "", "follow the wall clock, FACTOR times faster", metavar="FACTOR")
    flag(options, "--steer", "", "with --realtime: let MAVLink clients steer UAVs, by UDP", metavar="[HOST:]PORT")
    flag(options, "--metrics", "", "serve metrics to Prometheus here; port 0: any free one", metavar="[HOST:]PORT")
    flag(options, "--uavs-per-process", "1", "with --tls: UAVs that each agent may fly", int, "M")
    flag(options, "--resume", "", "file from which to resume, written by `meanflock resume`", metavar="FILE")
    options.add_argument(
        "--set",
        action="append",
        default=os.environ.get("MEANFLOCK_SET", "").split(),
        metavar="KEY=VALUE",
        help="one setting of the scenario, repeatable ($MEANFLOCK_SET: several, between spaces)",
    )
    given = options.parse_args()
    logs.start(given.log_format, run=given.run, node=WORLD)
    metrics = Address.parse("--metrics", given.metrics).free("--metrics") if given.metrics else None
    realtime = factor(given.realtime) if given.realtime else None
    steer = Address.parse("--steer", given.steer) if given.steer else None
    if steer is not None and realtime is None:
        raise BadInput(LOCKSTEP)
    flown = scenario.load(Path(given.scenario) if given.scenario else None, given.set)
    rows = given.uavs_per_process
    if rows < 1:
        raise BadInput(f"--uavs-per-process {rows}: an agent flies at least one UAV")
    if given.stations < 0:
        raise BadInput(f"--stations {given.stations}: 0 or more")
    rows_at_most = rows if given.tls else None
    interrupted = Interrupted()
    end_with_launcher()
    logs.divert()  # standard output carries the summary only
    limits = Limits(plan_of(flown))
    quotas = Quotas(keys.check_run(given.run), flown, limits, rows_at_most)
    bus = ZenohBus.router(
        given.endpoint,
        identity(given.tls, WORLD),
        access.rules(given.run, flown.uavs, rows),
        quotas,
        quotas.largest,
        -(-flown.uavs // rows) + MAX_LEADERS + 1,
    )
    if given.endpoint.endswith(":0"):
        logs.show(f"the world listens at {bus.endpoint}")
    with ExitStack() as stack:
        stack.callback(bus.close)
        port = None
        if steer is not None:
            with needed("--steer", "mavlink"):
                from meanflock.bridge.steering_port import SteeringPort
            port = stack.enter_context(SteeringPort(steer, flown.uavs, flown.dt))
        bus.announce(keys.alive(given.run, "world", "world"))

        def over() -> bool:
            return bool(interrupted) or orphaned()

        flight = NetworkedRun(
            flown,
            bus,
            given.run,
            Resumption.load(Path(given.resume)) if given.resume else None,
            limits=limits,
            stations=given.stations,
            barrier_s=given.barrier,
            realtime=realtime,
            steer=port,
            rows_at_most=rows_at_most,
            cancelled=over,
        )
        flight.world.counters.refused = bus.dropped
        threads.renew()
        if metrics is not None:
            with needed("--metrics", "world"):  # the library is loaded only if it is used
                from meanflock.net.exporter import Exporter, exported

            exporter = Exporter(flight.world, given.run, MODE, flight.watch, flight.nodes, flight.outbox)
            flight.sinks.append(exporter)
            logs.show(f"metrics at {stack.enter_context(exported(exporter, metrics))}")
        ready()
        flight.gather(given.wait)
        for tick in flight.fly():
            if interrupted or (tick % 50 == 0 and orphaned()):
                break
        record = flight.finish(lambda: _linger_s(hurried=bool(interrupted) or not flight.world.over))
        print(json.dumps(record, indent=1), flush=True)
        _see_off(flight.nodes, bus)
        if interrupted:
            raise RunFailed("interrupted; the summary is of what was flown")
        if every_uav_was_lost(flown, record):
            raise RunFailed("every UAV was lost; the summary is of what was flown")


def _linger_s(hurried: bool) -> float:
    """Time that the world waits for a recorder that acknowledges nothing, s. If a launcher started the world, there is
    no limit while the launcher lives, because the user may have stopped it.
    """
    if orphaned():
        return 0.0
    if hurried:
        return HURRIED_S
    return math.inf if launched() else LINGER_S


def _see_off(nodes: RemoteCrew, bus: ZenohBus) -> None:
    """Wait until every node has left. The last message to a node can be lost if the router closes before."""
    end = time.monotonic() + SEE_OFF_S
    while nodes.members.present and time.monotonic() < end:
        if (delivery := bus.receive(0.1)) is not None:
            nodes.handle(delivery)


if __name__ == "__main__":
    main(run)
