"""One federated round: upload, average, broadcast, apply; on processes."""

from collections.abc import Callable
from statistics import median

from benchmarks import sizes
from benchmarks.figure import Effort, Figure, Outcome, Say, per_call_ms, per_tick_ms
from benchmarks.lockstep_floor import floor_of
from benchmarks.processes import Children
from meanflock.net.networked import NetworkedRun
from meanflock.net.session import ZenohBus
from meanflock.swarm import scenario
from meanflock.swarm.wire.messages import FrameKind
from meanflock.worldsim.world import REPORT_EVERY_TICKS

TITLE = "A federated round"
ABOUT = (
    "25 agent processes and the leader's, mfgfl-hf, a round every 25 ticks. A round takes three ticks: uploads are "
    "sent; they are averaged and the result is broadcast; it is applied. Compared with three ordinary ticks of the "
    "same run, and with a bare Zenoh lockstep that carries messages of the same sizes on the same ways: 20 × 984 bytes "
    "in, all of them to the leader, 984 bytes back, 984 bytes to each of 25."
)
UAVS = 25
PERIOD = 25
ROUND_TICKS = 3
TARGET_MS = 10.0
CHUNK = 2 * PERIOD  # a round at PERIOD and one at 2 PERIOD, which is also a tick of reports and is left out
_HF = "mfgfl-hf"


def run(effort: Effort, say: Say) -> Outcome:
    """Swarm and floor alive side by side, flown in turns."""
    chunks = effort.choose(12, 3)
    flown = scenario.load(
        None, ["stop=duration", "duration=1e6", f"federation.period={PERIOD}"], uavs=UAVS, method=str(_HF)
    )
    names = [f"agent-{number}" for number in range(UAVS)]
    rounds: dict[str, list[float]] = {"swarm": [], "floor": []}
    ordinary: dict[str, list[float]] = {"swarm": [], "floor": []}
    with Children("rounds") as swarm, Children("floor") as floor, floor_of(floor, [*names, "leader"]) as bare:
        say("starting 2 × 26 processes")
        bus = ZenohBus.router(swarm.endpoint)
        try:
            world = NetworkedRun(flown, bus, swarm.run)
            swarm.start("meanflock.leader")
            swarm.start("meanflock.agent", "--count", str(UAVS))
            floor.start("benchmarks.lockstep_floor", "--count", str(UAVS))
            floor.start("benchmarks.lockstep_floor", "--node", "leader")
            world.gather(60.0)
            bare.gather()
            ticks = world.fly()
            shape = _shape(flown.participants, names)
            for _ in range(CHUNK):
                next(ticks)
            for chunk in range(chunks):
                say(f"round {chunk + 1} of {chunks}")
                mine = [per_tick_ms(ticks, 1) for _ in range(CHUNK)]
                its = [per_call_ms(lambda k=k: bare.tick(shape(k)), 1) for k in range(CHUNK)]
                for who, times in (("swarm", mine), ("floor", its)):
                    rounds[who].append(sum(times[PERIOD : PERIOD + ROUND_TICKS]))
                    calm = [t for k, t in enumerate(times) if k % PERIOD >= ROUND_TICKS and k % REPORT_EVERY_TICKS]
                    ordinary[who].append(median(calm))
            uploads = world.world.air.meter.traffic[FrameKind.UPLOAD]
            broadcasts = world.world.air.meter.traffic[FrameKind.GLOBAL]
            world.nodes.stop("measured")
            swarm.wait(3.0)
        finally:
            bus.close()
    payload = flown.participants * sizes.upload(_HF).payload.nbytes
    return _outcome(rounds, ordinary, uploads.wire_bytes, broadcasts.transmissions, payload)


def _shape(participants: int, names: list[str]) -> Callable[[int], dict[str, tuple[int, int]]]:
    """Bytes out and back for each name in tick k of a chunk."""
    calm = (sizes.size(sizes.sense()), sizes.size(sizes.act()))
    sends = (calm[0], sizes.size(sizes.act((sizes.upload(_HF),))))
    hears = (sizes.size(sizes.sense((sizes.broadcast(_HF),))), calm[1])
    averages = (sizes.size(sizes.sense((sizes.upload(_HF, participants),))), sends[1])
    ordinary = dict.fromkeys(names, calm)
    upload = ordinary | dict.fromkeys(names[:participants], sends)
    average = ordinary | {"leader": averages}
    applied = dict.fromkeys(names, hears)
    special = {0: upload, 1: average, 2: applied}
    return lambda tick: special.get(tick % PERIOD, ordinary)


def _outcome(
    rounds: dict[str, list[float]], ordinary: dict[str, list[float]], wire: int, rounds_flown: int, payload: int
) -> Outcome:
    extra = {
        who: [r - ROUND_TICKS * o for r, o in zip(rounds[who], ordinary[who], strict=True)]
        for who in ("swarm", "floor")
    }
    bare_round = Figure("bare Zenoh, three ticks of those sizes", "ms", rounds["floor"])
    models = Figure("models of a round, payload", "B", [float(payload)], "neither")
    bare_tick = Figure("bare Zenoh, ordinary tick", "ms", ordinary["floor"])
    return Outcome(
        [
            Figure("the three ticks of a round", "ms", rounds["swarm"], floor=bare_round),
            bare_round,
            Figure("an ordinary tick", "ms", ordinary["swarm"], floor=bare_tick),
            bare_tick,
            Figure("what a round adds", "ms", extra["swarm"], target=TARGET_MS),
            Figure("what those sizes add to bare Zenoh", "ms", extra["floor"], "neither"),
            models,
            Figure("its wire bytes, up", "B", [wire / rounds_flown], floor=models),
        ]
    )
