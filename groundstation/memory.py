"""Memory that a swarm needs, and available memory of this machine or container."""

from collections.abc import Iterator
from pathlib import Path

import psutil

from meanflock.swarm import forks

MEGABYTE = 2**20
# Measured values plus a quarter. Private memory of a process; shared memory is counted once.
AGENT_MB = 17 if forks.SAFE else 28  # forked from a loaded process, or started separately
IN_PROCESS_MB = 220  # all rooms and the recorder in one process
NETWORKED_MB = 450  # world, leader, ground station, and 64 MiB of telemetry that may wait
UAV_KB = 50
PAIR_BYTES = 330  # if UAVs share states: the states known to each UAV, and the links of a tick

_V1_NO_LIMIT = 2**60  # cgroup v1 means no limit by a huge number


def needed_mb(uavs: int, processes: int, keeps_states: bool = False) -> int:
    """Estimate of the resident memory of a run, MB, rather too high.

    Args:
        processes: number of agents' processes; 0: all in one process. keeps_states: whether every UAV stores the states
            of all others.
    """
    fixed = NETWORKED_MB + AGENT_MB * processes if processes else IN_PROCESS_MB
    return fixed + UAV_KB * uavs // 1024 + (PAIR_BYTES * uavs * uavs // MEGABYTE if keeps_states else 0)


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
