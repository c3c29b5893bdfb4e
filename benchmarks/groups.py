"""Groups: a tick of a flight of groups, beside the same UAVs with its most expensive controller for all."""

from benchmarks.figure import Effort, Figure, Outcome, Say, in_turns, per_tick_ms
from meanflock.launch.engine import Engine
from meanflock.swarm.scenario import Scenario

TITLE = "Groups of UAVs"
ABOUT = (
    "The scenario `groups` and multiples of it in one process: learners and a reserve of `mfgfl-hf`, couriers of "
    "`orca`, all behind `ecbf`. The floor is `orca` for all UAVs. Learners and reserve are one agent, couriers "
    "another, so a small swarm pays for two controllers and two filters."
)
TIMES = (1, 4, 12)  # UAVs, as multiples of the scenario's
LARGEST = 1.0  # asked of the ratio
CHUNK = 50


def scene(times: int) -> Scenario:
    """The scenario with so many times its UAVs, which flies as long as it is asked to."""
    one = Scenario.load("groups")
    groups = {f"groups.{group.name}.count": times * group.count for group in one.groups}
    return one.replace(uavs=times * one.uavs, stop="duration", duration=1e6, **groups)


def run(effort: Effort, say: Say) -> Outcome:
    """Flights, in turns."""
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
    figures = []
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
