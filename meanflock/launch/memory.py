"""Memory that a swarm needs, and available memory of this machine or container."""

from bisect import bisect
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import psutil

from meanflock.federation.plan import plan_of
from meanflock.launch import forks
from meanflock.swarm import state
from meanflock.swarm.declared import NO_LEARNER
from meanflock.swarm.errors import BadInput
from meanflock.swarm.mission import starts
from meanflock.swarm.scenario import Scenario

MEGABYTE = 2**20
# Measured values plus a quarter. Private memory of a process; shared memory is counted once.
AGENT_MB = 17 if forks.SAFE else 28  # forked from a loaded process, or started separately
IN_PROCESS_MB = 220  # all rooms and the recorder in one process
NETWORKED_MB = 450  # world, leader, ground station, and 64 MiB of telemetry that may wait
UAV_KB = 4  # a UAV without what it learns
_WEIGHT_BYTES = 45  # of a number that a UAV learns: weights, reports and checkpoints
_ROUND_BYTES = 30  # more, if the flight has rounds: models that are sent, received and averaged
PAIR_BYTES = 330  # if UAVs share states: the states known to each UAV, and the links of a tick; or models: the mail
FAR_PAIR_BYTES = 60  # if the UAVs do not reach all others

# Of an environment, for each pair of UAVs.
_WAITING_BYTES = 50  # of a flight while another one flies its tick: the states known to each UAV
_MESSAGE_BYTES = 45  # more for each number of a message, in the flight that flies its tick
_WAITING_MESSAGE_BYTES = 10  # in the others

_BARE_MB = 110  # this process without the libraries of a learner
_COPIED = 0.2  # share of a learner's libraries that a fork writes to, so that it has a copy
_FLOAT_BYTES = 75  # of a learner's model, for each UAV: the model itself, of rounds, trainings and checkpoints
_SENT_FLOAT_BYTES = 165  # more, if agents have processes: messages, and what world and leader store of them

_SMALL_MB = 500  # a flight in this process that is never refused
_LARGE_MB = 10240  # from which on a text has GiB
_ROWS = 25  # UAVs in a process, as advice for too many processes

_V1_NO_LIMIT = 2**60  # cgroup v1 means no limit by a huge number


def pair_bytes(scenario: Scenario) -> int:
    """Bytes that a flight needs for each pair of UAVs, if memory grows with N²; else 0."""
    plan = plan_of(scenario)
    if plan.declared.pairwise:
        return PAIR_BYTES
    to_all = [hop for hop in plan.hops if hop.targets is None and not hop.is_local]
    if all(len(hop.senders) < scenario.uavs for hop in to_all):
        return 0
    places = state.position(starts(plan.given))
    largest = float(np.linalg.norm(np.ptp(places, axis=0)))
    return PAIR_BYTES if all(largest <= (hop.range_m or largest) for hop in to_all) else FAR_PAIR_BYTES


class LearnerMemory(NamedTuple):
    """Memory of what UAVs learn. imported_mb: of the libraries of a learner. uav_bytes: of the model of a UAV.
    sent_bytes: more of it, if agents have processes of their own."""

    imported_mb: int = 0
    uav_bytes: int = 0
    sent_bytes: int = 0


def learner_memory(scenario: Scenario) -> LearnerMemory:
    """Memory of what the UAVs of a scenario learn. The libraries of a learner are measured in this process, which has
    imported them."""
    if scenario.training.learner == NO_LEARNER:
        plan = plan_of(scenario)
        has_rounds = plan.hops and plan.period_ticks <= scenario.max_ticks
        return LearnerMemory(0, (_WEIGHT_BYTES + (_ROUND_BYTES if has_rounds else 0)) * plan.declared.weights)
    imported_mb = max(0, psutil.Process().memory_info().rss // MEGABYTE - _BARE_MB)
    floats = plan_of(scenario).declared.parameters
    return LearnerMemory(imported_mb, _FLOAT_BYTES * floats, _SENT_FLOAT_BYTES * floats)


def needed_mb(uavs: int, processes: int, pair_bytes: int = 0, learner: LearnerMemory | None = None) -> int:
    """Estimate of the resident memory of a run, MB, rather too high.

    Args:
        processes: number of agents' processes; 0: all in one process. pair_bytes: of each pair of UAVs. learner: None:
            there is none.
    """
    learner = learner or LearnerMemory()
    fixed, uav_bytes = IN_PROCESS_MB, UAV_KB * 1024 + pair_bytes * uavs + learner.uav_bytes
    if processes:
        fixed, uav_bytes = NETWORKED_MB + AGENT_MB * processes, uav_bytes + learner.sent_bytes
        copies = 1 + _COPIED * processes if forks.SAFE else processes
        fixed += int(learner.imported_mb * copies)
    return fixed + uav_bytes * uavs // MEGABYTE


def _in_words(needed: int, available: int) -> tuple[str, str]:
    """Needed and available memory, MB, with the same unit."""
    large = needed >= _LARGE_MB
    needs, left = (f"{mb / 1024:,.1f} GiB" if large else f"{mb} MB" for mb in (needed, available))
    return needs, left


def shortage(uavs: int, processes: int, pair_bytes: int = 0, learner: LearnerMemory | None = None) -> tuple[str, str]:
    """Needed and available memory in words, and what to do if it is too little; empty if it is enough."""
    needed, (available, limit) = needed_mb(uavs, processes, pair_bytes, learner), available_mb()
    where = f"{processes} processes" if processes else "one process"
    needs, left = _in_words(needed, available)
    found = f"{needs} for {uavs} UAVs in {where}, {left} {limit}"
    if needed <= available:
        return found, ""
    crowded = processes and needed_mb(uavs, -(-uavs // _ROWS), pair_bytes, learner) <= available
    remedy = f"more UAVs in a process: --uavs-per-process {_ROWS}" if crowded else "fewer UAVs: --uavs N"
    if pair_bytes and not crowded:
        each = uavs // processes if processes else uavs
        most = bisect(
            range(uavs), available, key=lambda n: needed_mb(n, -(-n // each) if processes else 0, pair_bytes, learner)
        )
        pairs = "each UAV stores the states of all others, or sends its model to all, so memory grows with N²"
        remedy = f"{pairs}: --uavs {most - 1}, or a --method without it" if most > 1 else f"{pairs}: another --method"
    return found, remedy


def check(flown: Iterable[Scenario]) -> None:
    """Check that each of some flights in this process, one after the other, fits into memory.

    Raises:
        BadInput: one does not; the text has the memory that it needs.
    """
    for scenario in flown:
        uavs, pairs, learner = scenario.uavs, pair_bytes(scenario), learner_memory(scenario)
        if needed_mb(uavs, 0, pairs, learner) < _SMALL_MB:
            continue
        found, remedy = shortage(uavs, 0, pairs, learner)
        if remedy:
            raise BadInput(f"memory: {found}; {remedy}")


def check_environment(uavs: int, flights: int, message: int) -> None:
    """Check that the flights of an environment fit into memory, of which one at a time flies a tick.

    Args:
        uavs: of each flight. message: W, numbers of a message.

    Raises:
        BadInput: they do not fit; the text has the memory that they need.
    """
    of_pair = PAIR_BYTES + _MESSAGE_BYTES * message
    of_pair += (flights - 1) * (_WAITING_BYTES + _WAITING_MESSAGE_BYTES * message)
    needed, (available, limit) = needed_mb(uavs, 0, of_pair), available_mb()
    if needed <= max(available, _SMALL_MB):
        return
    needs, left = _in_words(needed, available)
    most = bisect(range(1, uavs), available, key=lambda n: needed_mb(n, 0, of_pair))
    what = f"{uavs} UAVs" if flights == 1 else f"{flights} flights of {uavs} UAVs each"
    remedies = [f"take uavs={most} at most"] * (most > 0) + ["take fewer flights"] * (flights > 1)
    raise BadInput(
        f"memory: {needs} for an environment of {what}, {left} {limit}; each UAV stores what it knows of all others, "
        f"so memory grows with N²: {', or '.join(remedies or ['free memory'])}"
    )


def available_mb(root: Path = Path("/")) -> tuple[int, str]:
    """Available memory, MB, and the name of the limit."""
    machine = psutil.virtual_memory().available
    allowed = min(_allowances(root), default=machine)
    if allowed < machine:
        return max(0, allowed) // MEGABYTE, "left of this container's limit"
    return machine // MEGABYTE, "available"


def _allowances(root: Path) -> Iterator[int]:
    """Bytes left in the control group of this process, and in each of its parents."""
    try:
        lines = (root / "proc/self/cgroup").read_text(encoding="utf-8").splitlines()
    except OSError:
        return
    for line in lines:
        _, controllers, path = line.split(":", 2)
        if not controllers:
            mount, names = root / "sys/fs/cgroup", ("memory.max", "memory.current", "inactive_file")
        elif "memory" in controllers.split(","):
            mount = root / "sys/fs/cgroup/memory"
            names = ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file")
        else:
            continue
        group = mount / path.strip("/")
        for place in (
            group,
            *group.parents,
        ):  # in a container the path may be that of the host; then the limit is at the mount
            if place == mount or mount in place.parents:
                left = _left(place, *names)
                if left is not None:
                    yield left


def _left(group: Path, limit: str, used: str, reclaimable: str) -> int | None:
    """Bytes left in a control group; None without a limit."""
    try:
        most = (group / limit).read_text(encoding="ascii").strip()
        if most == "max" or int(most) >= _V1_NO_LIMIT:
            return None
        cache = [
            int(line.split()[1])
            for line in (group / "memory.stat").read_text(encoding="ascii").splitlines()
            if line.split()[0] == reclaimable
        ]
        return int(most) - int((group / used).read_text(encoding="ascii")) + sum(cache)
    except (OSError, ValueError):
        return None
