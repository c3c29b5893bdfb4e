"""Memory and descriptors of the processes of a swarm over its ticks, and whether they stay where they were."""

import time
from collections import defaultdict
from contextlib import suppress

import numpy as np
import psutil

from meanflock.recording.recorder import BATCH_TICKS, FILE_WALL_S
from tests.faults.by_hand import Flight

SLOPE_MIB = 1.0  # in a thousand ticks
# A recorder also keeps, for the footer of its file, an index of what it has sent. Measured with 9 UAVs: 0.07 MiB a
# batch, 0.5 MiB in a thousand ticks that take 14 s; an index half as large again is let pass.
BATCH_MIB = 0.1
SPAN_TICKS = 2000  # too short a life says nothing
_WARM_UP = 0.3  # of a life: caches fill, allocators settle
MIB = 2**20


class Vitals:
    def __init__(self, flight: Flight) -> None:
        self._flight = flight
        self.memory: dict[str, list[tuple[int, float]]] = defaultdict(list)  # tick, MiB of RSS
        self.seconds: dict[str, list[float]] = defaultdict(list)  # when that was, by a monotonic clock
        self.descriptors: list[int] = []  # of the world while all nodes are well

    def sample(self, tick: int, all_well: bool) -> None:
        """Notes the memory of each process, and the descriptors of the world while all nodes are well."""
        flight = self._flight
        for process in (flight.world, flight.station, *flight.agents, *flight.leaders):
            if process.poll() is None:
                name = f"{process.args[2].rpartition('.')[2]} {process.pid}"
                with suppress(psutil.NoSuchProcess):  # it may be killed right now
                    self.memory[name].append((tick, psutil.Process(process.pid).memory_info().rss / MIB))
                    self.seconds[name].append(time.monotonic())
        if all_well:
            self.descriptors.append(psutil.Process(flight.world.pid).num_fds())

    def slopes(self) -> dict[str, tuple[float, float, float]]:
        """Of every process that lived long enough: MiB in a thousand ticks, the first and the last sample judged."""
        found = {}
        for name, samples in self.memory.items():
            ticks, sizes = np.array(samples).T
            begin = ticks[0] + _WARM_UP * (ticks[-1] - ticks[0])
            kept = ticks >= begin
            if ticks[-1] - ticks[0] >= SPAN_TICKS and len(np.unique(ticks[kept])) > 5:
                slope = np.polyfit(ticks[kept], sizes[kept], 1)[0] * 1000
                found[name] = (float(slope), float(sizes[kept][0]), float(sizes[-1]))
        return found

    def bound(self, name: str) -> float:
        """By how much a process may grow in a thousand ticks, MiB."""
        if not name.startswith("groundstation"):
            return SLOPE_MIB
        ticks = self.memory[name][-1][0] - self.memory[name][0][0]
        batches = ticks / BATCH_TICKS + (self.seconds[name][-1] - self.seconds[name][0]) / FILE_WALL_S
        return SLOPE_MIB + BATCH_MIB * batches / ticks * 1000

    def broken(self) -> list[str]:
        told = [
            f"memory of {name} grows by {slope:.2f} MiB in a thousand ticks ({first:.1f} to {last:.1f} MiB)"
            for name, (slope, first, last) in self.slopes().items()
            if slope > self.bound(name)
        ]
        if self.descriptors and self.descriptors[-1] > self.descriptors[0]:
            told.append(f"the world's descriptors: {self.descriptors[0]} at first, {self.descriptors[-1]} at the end")
        return told
