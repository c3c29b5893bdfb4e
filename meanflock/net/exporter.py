"""Metrics of a run for Prometheus, over HTTP.

They are collected at each scrape, so a run that is not scraped pays nothing. The flight goes on meanwhile, so counters
of one scrape may be a tick apart.
"""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from prometheus_client import CollectorRegistry, ProcessCollector, start_http_server
from prometheus_client.metrics_core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    InfoMetricFamily,
    Metric,
)
from prometheus_client.registry import Collector

from meanflock.channel.meter import TRAFFIC
from meanflock.net.access import Address
from meanflock.net.outbox import Outbox
from meanflock.net.remote import RemoteCrew
from meanflock.swarm import __version__, mission
from meanflock.swarm.wire.messages import Status
from meanflock.worldsim.clocks import Durations, Stopwatch
from meanflock.worldsim.tick import Row
from meanflock.worldsim.world import World

_TRAFFIC_FIELDS = {  # field of `Traffic` → name and help of the metric
    "payload_bits": ("payload_bits", "Bits of payload, once a transmission."),
    "wire_bytes": ("wire_bytes", "Bytes of encoded frames as they crossed the bus."),
    "sent": ("link_copies", "Messages sent over a link; a broadcast to n UAVs is n."),
    "delivered": ("deliveries", "Link copies that arrived."),
    "outages": ("outages", "Link copies given up."),
}


class Exporter(Collector):
    """Metric families of one run. Unknown is absent, never 0. As a sink it measures how long ticks take.

    Attributes:
        ticks: durations of whole ticks, from row to row.
    """

    def __init__(
        self,
        world: World,
        run: str,
        mode: str,
        watch: Stopwatch,
        crew: RemoteCrew | None = None,
        outbox: Outbox | None = None,
    ) -> None:
        """
        Args:
            world: what flies. run: name of the run. mode: how its nodes run. watch: the time flown.
            crew: nodes on a bus; None: all nodes are in this process.
            outbox: telemetry that stations acknowledge; None without a bus.
        """
        self.ticks = Durations()
        self._world = world
        self._run = run
        self._mode = mode
        self._watch = watch
        self._crew = crew
        self._outbox = outbox
        self._told_s = 0.0  # of the flight, at the last row

    def write(self, row: Row) -> None:
        """Count the time since the last row."""
        now_s = self._watch.flown_s
        self.ticks.add(now_s - self._told_s)
        self._told_s = now_s

    def collect(self) -> Iterator[Metric]:
        """All metrics, as they are now."""
        yield from self._flight()
        yield from self._radio()
        yield from self._protocol()
        if self._crew is not None:
            yield from self._nodes(self._crew)
            yield _histogram("barrier_wait_seconds", "How long a tick waited for replies.", self._crew.waits)
        yield _histogram("tick_seconds", "How long a tick took in all.", self.ticks)

    def _flight(self) -> Iterator[Metric]:
        flight = self._world.flight
        about = {"run": self._run, "mode": self._mode, "version": __version__}
        yield InfoMetricFamily("meanflock_run", "Which run this is.", {**about, "method": self._world.plan.method})
        yield _counter("ticks", "Ticks flown.", flight.tick)
        yield _counter("simulated_seconds", "Simulated time.", flight.time_s)
        if flight.tick:
            factor = flight.time_s / self._watch.seconds
            yield GaugeMetricFamily("meanflock_real_time_factor", "Simulated seconds a second, since take-off.", factor)
        parts = [([group.name], rows) for group, rows in mission.parts(flight.scenario)] or [([], slice(None))]
        labels = ["status", "group"][: 1 + len(parts[0][0])]
        uavs = GaugeMetricFamily("meanflock_uavs", "UAVs by state of the mission, and by group.", labels=labels)
        for name, rows in parts:
            for status in Status:
                count = np.count_nonzero(flight.status[rows] == status)
                uavs.add_metric([status.name.lower(), *name], float(count))
        yield uavs

    def _radio(self) -> Iterator[Metric]:
        for field, (name, help_text) in _TRAFFIC_FIELDS.items():
            family = CounterMetricFamily(f"meanflock_{name}", help_text, labels=["traffic"])
            for kind, traffic in TRAFFIC.items():
                family.add_metric([traffic], getattr(self._world.air.meter.traffic[kind], field))
            yield family

    def _protocol(self) -> Iterator[Metric]:
        counters = self._world.counters
        post = self._world.ledger
        yield _counter("rounds", "Rounds averaged and broadcast.", post.rounds)
        yield _counter("rounds_void", "Rounds without a model of another UAV to average.", post.rounds_void)
        yield _counter("uploads_silent", "Uploads that participants did not send.", post.silent)
        yield _counter("uploads_late", "Uploads that were delivered after the deadline.", post.late)
        yield _counter("uploads_refused", "Uploads that a node received and did not average.", counters.uploads_refused)
        yield _counter("rounds_isolated", "Rounds in which a UAV that averages received no other model.", post.isolated)
        drops = CounterMetricFamily("meanflock_dropped_messages", "Messages not let in, by reason.", labels=["reason"])
        for reason, count in sorted(counters.dropped.items()):
            drops.add_metric([reason], count)
        yield drops
        yield _counter("held_commands", "Commands held over because they came late, in real time.", counters.held)
        yield _counter("deadline_misses", "Ticks in which a command came late, in real time.", counters.deadline_misses)
        if self._outbox is not None:
            waiting = self._outbox.waiting
            help_text = "Blocks of telemetry no ground station has acknowledged yet."
            yield GaugeMetricFamily("meanflock_telemetry_blocks_unacknowledged", help_text, waiting)
            dropped = self._outbox.dropped
            yield _counter("telemetry_blocks_dropped", "Blocks given up because too many waited.", dropped)

    def _nodes(self, crew: RemoteCrew) -> Iterator[Metric]:
        roles = [member.role for member in crew.members.present]
        alive = GaugeMetricFamily("meanflock_nodes_alive", "Nodes that take part and are not lost.", labels=["role"])
        for role, count in (
            ("world", 1),
            ("leader", roles.count("leader")),
            ("agent", roles.count("agent")),
            ("station", len(crew.listeners)),
        ):
            alive.add_metric([role], count)
        yield alive
        yield _counter("nodes_lost", "Nodes lost in flight.", self._world.counters.nodes_lost)
        yield _counter("nodes_rejoined", "Nodes that joined in flight.", self._world.counters.nodes_rejoined)


@contextmanager
def exported(exporter: Exporter, address: Address) -> Iterator[str]:
    """Serve the metrics of a run while the context lasts; its value is the URL.

    Raises:
        BadInput: the address cannot be listened on.
    """
    shown = CollectorRegistry()
    shown.register(exporter)
    ProcessCollector("", lambda: "self", "/proc", shown)  # memory, CPU and files of this process, under the usual names
    try:
        server, thread = start_http_server(address.port, address.host, shown)
    except OSError as error:
        raise address.refused("--metrics", error) from error
    try:
        yield f"http://{Address(address.host, server.server_port)}/metrics"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def _counter(name: str, help_text: str, value: float) -> Metric:
    return CounterMetricFamily(f"meanflock_{name}", help_text, value)


def _histogram(name: str, help_text: str, durations: Durations) -> Metric:
    return HistogramMetricFamily(f"meanflock_{name}", help_text, durations.cumulative, durations.total_s)
