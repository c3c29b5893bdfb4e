"""Groups: a tick of a flight of groups, beside the same UAVs with its most expensive controller for all."""

from benchmarks.figure import Effort, Figure, Outcome, Say, in_turns, per_tick_ms
from benchmarks.processes import meanflock
from meanflock.launch.engine import Engine
from meanflock.swarm.scenario import Scenario

TITLE = "Groups of UAVs"
ABOUT = (
    "The scenario `groups`: learners and a reserve of `mfgfl-hf`, couriers of `orca`, all behind `ecbf`. The floor is "
    "the most expensive of these controllers, `orca`, for all UAVs. First as `meanflock run groups` flies it, with a "
    "process for each UAV; then the scenario and multiples of it in one process, where learners and reserve are one "
    "agent and couriers another, so a small swarm pays for two controllers and two filters."
)
TIMES = (1, 4, 12)  # UAVs, as multiples of the scenario's
LARGEST = 1.0  # asked of the ratio
CHUNK = 50
ORCA = ("--set", "groups=[]", "--method", "orca")
NETWORKED_S = 60.0  # until after the reserve has joined


def scene(times: int) -> Scenario:
    """The scenario with so many times its UAVs, which flies as long as it is asked to."""
    one = Scenario.load("groups")
    groups = {f"groups.{group.name}.count": times * group.count for group in one.groups}
    return one.replace(uavs=times * one.uavs, stop="duration", duration=1e6, **groups)


def networked(effort: Effort, say: Say) -> list[Figure]:
    """Flights with a process for each UAV, in turns."""
    ms: dict[str, list[float]] = {"groups": [], "orca": []}
    for repeat in range(turns := effort.choose(5, 1)):
        say(f"a process for each UAV, {repeat + 1} of {turns}")
        for name, flags in (("groups", ()), ("orca", ORCA)):
            flight = ("groups", *flags, "--set", "stop=duration", "--duration", f"{NETWORKED_S}")
            summary, _ = meanflock(*flight)
            ms[name].append(summary["wall_time_s"] / summary["ticks"] * 1e3)
    uavs = Scenario.load("groups").uavs
    floor = Figure(f"tick, orca for all, {uavs} processes", "ms/tick", ms["orca"])
    tick = Figure(f"tick, three groups, {uavs} processes", "ms/tick", ms["groups"], floor=floor, ratio_target=LARGEST)
    return [tick, floor]


def run(effort: Effort, say: Say) -> Outcome:
    """Flights, in turns."""
    figures = networked(effort, say)
    say("take-off")
    flights = {}
    for times in TIMES:
        grouped = scene(times)
        ungrouped = grouped.replace(groups=[], method="orca", **{"federation.group": None})
        for name, flown in (("groups", grouped), ("orca", ungrouped)):
            flights[name, times] = Engine(flown, "benchmark").fly()
    for ticks in flights.values():
        per_tick_ms(ticks, 5 * CHUNK)  # until the reserve has joined
    say("in turns")
    ms = in_turns(
        effort.choose(20, 4),
        {name: (lambda ticks=ticks: per_tick_ms(ticks, CHUNK)) for name, ticks in flights.items()},
    )
    for times in TIMES:
        uavs = times * Scenario.load("groups").uavs
        floor = Figure(f"tick, orca for all, {uavs} UAVs", "ms/tick", ms["orca", times])
        figures.append(
            Figure(
                f"tick, three groups, {uavs} UAVs", "ms/tick", ms["groups", times], floor=floor, ratio_target=LARGEST
            )
        )
        figures.append(floor)
    return Outcome(figures)
