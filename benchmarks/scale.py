"""Cost of a UAV as the swarm grows."""

from collections.abc import Callable
from statistics import median

from benchmarks.figure import Effort, Figure, Outcome, Say, in_turns, per_call_ms, per_tick_ms
from benchmarks.in_process import flight, learner_step
from benchmarks.processes import meanflock
from meanflock.swarm.workers import cores, each

TITLE = "From 25 to 100,000 UAVs"
ABOUT = (
    "Cost of one UAV's tick, mfgfl-hf, all in one process; the floor is the learner's step alone on as many rows. The "
    "ticks measured are those between rounds, of all sizes in turns; *growth* is 1000 UAVs beside the cheapest. Then "
    "hjb, where every UAV speaks to every other in every tick; large swarms on all cores, beside the learner's step on "
    "the same cores and beside real time; and the networked swarm of 1000 UAVs as four processes of 250 rows, recorded."
)
SIZES = (25, 50, 100, 250, 500, 1000)
BEYOND = 4000  # for the cost model of docs/scaling.md
LARGE, MASSIVE = 10_000, 100_000  # the cores of the process share their rows
SPEAKING = (25, 50, 100)
ROWS = 250
GROWTH = 1.3


def run(effort: Effort, say: Say) -> Outcome:
    """N = 25 … 1000 in process, then 1000 over the network."""
    outcome = Outcome(details={"samples": []})

    def keep(uavs: int, links: int, ms: list[float], processes: int = 0) -> None:
        sample = {"uavs": uavs, "processes": processes, "links": links, "ms": min(ms)}
        outcome.details["samples"].append(sample)

    sizes = (*SIZES, BEYOND) if effort is Effort.FULL else (25, 250, 1000)
    measures: dict[str, Callable[[], float]] = {}
    for uavs in sizes:
        say(f"{uavs} UAVs in one process: take-off")
        ticks, step = flight("mfgfl-hf", uavs).fly(), learner_step("mfgfl-hf", uavs)
        chunk = max(2, effort.choose(1000, 250) // uavs)
        per_tick_ms(ticks, 3)
        measures[f"tick {uavs}"] = lambda t=ticks, n=chunk: per_tick_ms(t, n)
        measures[f"step {uavs}"] = lambda s=step, n=chunk: per_call_ms(s, n)
    say("all sizes in turns")
    ms = in_turns(effort.choose(9, 3), measures)
    cost: dict[int, list[float]] = {}
    for uavs in sizes:
        keep(uavs, 0, ms[f"tick {uavs}"])
        floor = Figure(f"learner step alone, {uavs} rows", "µs/UAV", [1e3 * t / uavs for t in ms[f"step {uavs}"]])
        mine = cost[uavs] = [1e3 * t / uavs for t in ms[f"tick {uavs}"]]
        outcome.figures += [Figure(f"UAV-tick, N = {uavs}", "µs/UAV-tick", mine, floor=floor), floor]
    cheapest = min((cost[uavs] for uavs in sizes if uavs <= SIZES[-1]), key=median)
    growth = [mine / least for mine, least in zip(cost[SIZES[-1]], cheapest, strict=True)]
    outcome.figures.append(Figure("growth of a UAV-tick to N = 1000", "×", growth, target=GROWTH))
    for uavs in SPEAKING if effort is Effort.FULL else SPEAKING[:1]:
        say(f"{uavs} UAVs that speak, in one process")
        ticks, links = flight("hjb", uavs).fly(), uavs * (uavs - 1)
        per_tick_ms(ticks, 3)
        ms_each = [per_tick_ms(ticks, max(2, effort.choose(300, 100) // uavs)) for _ in range(effort.choose(9, 3))]
        keep(uavs, links, ms_each)
        outcome.figures.append(Figure(f"tick, hjb, N = {uavs}, {links} links", "ms/tick", ms_each))
    outcome.figures += _large(effort, say)
    factors = []
    ticks = effort.choose(100, 30)
    for repeat in range(effort.choose(2, 1)):
        say(f"1000 UAVs in {1000 // ROWS} processes, {repeat + 1}")
        flags = ("--uavs", "1000", "--uavs-per-process", str(ROWS), "--set", "stop=duration")
        summary, _ = meanflock(*flags, "--duration", str(ticks / 10))
        factors.append(summary["real_time_factor"])
    outcome.figures.append(
        Figure("real-time factor, 1000 UAVs in 4 processes", "×", factors, "higher", target=1.0, stretch=5.0)
    )
    keep(1000, 0, [100.0 / factor for factor in factors], 1000 // ROWS)
    outcome.notes.append(
        "A sweep along x finds close pairs, so a UAV is compared with its neighbours only; alignment of up to 3,000 "
        "UAVs is a sum over all N²/2 pairs, in single precision, at 0.3 ns a pair: what is left of the growth. "
        "[Scaling](scaling.md) says what that means for larger swarms."
    )
    return outcome


def _large(effort: Effort, say: Say) -> list[Figure]:
    """10,000 UAVs beside the learner's step on the same cores, and 100,000 beside real time."""
    say(f"{LARGE} UAVs in one process")
    ticks, parts = flight("mfgfl-hf", LARGE).fly(), cores()
    steps = [learner_step("mfgfl-hf", -(-LARGE // parts)) for _ in range(parts)]
    chunk = effort.choose(10, 3)
    per_tick_ms(ticks, 3)
    measures = {
        "tick": lambda: per_tick_ms(ticks, chunk),
        "step": lambda: per_call_ms(lambda: each(_call, steps), chunk),
    }
    ms = in_turns(effort.choose(9, 3), measures)
    floor = Figure(f"learner step alone, {LARGE} rows on all cores", "ms", ms["step"])
    figures = [Figure(f"tick, N = {LARGE}", "ms/tick", ms["tick"], floor=floor), floor]
    if effort is Effort.FULL:
        say(f"{MASSIVE} UAVs in one process")
        ticks_of_all = flight("mfgfl-hf", MASSIVE).fly()
        per_tick_ms(ticks_of_all, 2)
        factors = [100.0 / per_tick_ms(ticks_of_all, 5) for _ in range(5)]
        figures.append(Figure(f"real-time factor, {MASSIVE} UAVs in one process", "×", factors, "higher", target=1.0))
    return figures


def _call(step: Callable[[], object]) -> object:
    return step()
