"""What a UAV costs as the swarm grows."""

from benchmarks.figure import Effort, Figure, Outcome, Say, in_turns, per_call_ms, per_tick_ms
from benchmarks.in_process import flight, learner_step
from benchmarks.processes import meanflock

TITLE = "From 25 to 1000 UAVs"
ABOUT = (
    "Cost of one UAV's tick, mfgfl-hf, all in one process; the floor is the learner's step alone on as many rows. The "
    "ticks measured are those between rounds. Then the networked swarm of 1000 UAVs as four processes of 250 rows, "
    "recorded."
)
SIZES = (25, 50, 100, 250, 500, 1000)
ROWS = 250


def run(effort: Effort, say: Say) -> Outcome:
    """N = 25 … 1000 in process, then 1000 over the network."""
    outcome = Outcome()
    for uavs in SIZES if effort is Effort.FULL else (25, 250, 1000):
        say(f"{uavs} UAVs in one process")
        ticks, step = flight("mfgfl-hf", uavs).fly(), learner_step("mfgfl-hf", uavs)
        chunk = max(2, effort.of(1000, 250) // uavs)
        per_tick_ms(ticks, 3)
        ms = in_turns(
            effort.of(9, 3),
            {"tick": lambda t=ticks, n=chunk: per_tick_ms(t, n), "step": lambda s=step, n=chunk: per_call_ms(s, n)},
        )
        floor = Figure(f"learner step alone, {uavs} rows", "µs/UAV", [1e3 * t / uavs for t in ms["step"]])
        mine = [1e3 * t / uavs for t in ms["tick"]]
        outcome.figures += [Figure(f"UAV-tick, N = {uavs}", "µs/UAV-tick", mine, floor=floor), floor]
    factors = []
    ticks = effort.of(100, 30)
    for repeat in range(effort.of(2, 1)):
        say(f"1000 UAVs in {1000 // ROWS} processes, {repeat + 1}")
        flags = ("--uavs", "1000", "--uavs-per-process", str(ROWS), "--set", "stop=duration")
        summary, _ = meanflock(*flags, "--duration", str(ticks / 10))
        factors.append(summary["real_time_factor"])
    outcome.figures.append(Figure("real-time factor, 1000 UAVs in 4 processes", "×", factors, "higher"))
    outcome.notes.append(
        "The rows of a tick grow with N, and so does a UAV's share of the pair metrics: alignment and risk are exact "
        "over all N² pairs."
    )
    return outcome
