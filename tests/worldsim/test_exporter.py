"""Metrics over HTTP, read by the parser of Prometheus: the numbers of the summary, and the same flight."""

import urllib.request
from collections.abc import Iterator
from typing import Any

import pytest
from prometheus_client.parser import text_string_to_metric_families

from meanflock.launch.station import StoredTelemetry
from meanflock.net import keys
from meanflock.net.access import Address
from meanflock.net.exporter import Exporter, exported
from meanflock.net.outbox import Outbox
from meanflock.swarm.scenario import load
from meanflock.worldsim.clocks import BOUNDS_S
from tests.memory_swarm import MemorySwarm
from tests.polling import DEADLINE_S

RUN = "watched"
ANY = Address("127.0.0.1", 0)


class Scrape:
    """The samples of one answer, by name and labels."""

    def __init__(self, url: str) -> None:
        with urllib.request.urlopen(url, timeout=DEADLINE_S) as answer:
            self.families = list(text_string_to_metric_families(answer.read().decode()))
        self._samples = {
            (sample.name, frozenset(sample.labels.items())): sample.value
            for family in self.families
            for sample in family.samples
        }

    def __call__(self, name: str, **labels: str) -> float:
        return self._samples[f"meanflock_{name}", frozenset(labels.items())]


@pytest.fixture
def engine() -> MemorySwarm:
    settings = ["uavs=6", "seed=3", "duration=12", 'stop="duration"', "federation.period=20", "radio.target_snr_db=78"]
    flown = load(None, settings, method="mfgfl-hf", faults=[{"kind": "kill", "uavs": [4], "time_s": 3.0}])
    return MemorySwarm(flown, RUN, uavs_per_node=2, sinks=[StoredTelemetry()])


@pytest.fixture
def exporter(engine: MemorySwarm) -> Exporter:
    exporter = Exporter(engine.world, RUN, "processes", engine.watch, engine.nodes, engine.outbox)
    engine.sinks.append(exporter)
    return exporter


@pytest.fixture
def url(exporter: Exporter) -> Iterator[str]:
    with exported(exporter, ANY) as url:
        yield url


def test_every_metric_is_the_number_of_the_summary(
    engine: MemorySwarm, exporter: Exporter, url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    network = engine.network.endpoint()
    for tick in engine.fly():
        if tick == 7:
            network.put(keys.act(RUN, "agent-0"), b"nonsense")
            network.put(keys.act(RUN, "agent-99"), b"nonsense")
    with monkeypatch.context() as patch:
        patch.setattr(Outbox, "waiting", 7)
        scraped = Scrape(url)
    summary: dict[str, Any] = engine.finish()
    assert scraped("ticks_total") == summary["ticks"] == 120
    assert scraped("simulated_seconds_total") == summary["sim_time_s"]
    fastest = summary["sim_time_s"] / exporter.ticks.total_s
    assert 0.0 < summary["real_time_factor"] <= scraped("real_time_factor") <= fastest
    for name in ("rounds", "rounds_void", "rounds_isolated", "uploads_silent", "uploads_late", "uploads_refused"):
        assert scraped(f"{name}_total") == summary[name]
    assert summary["rounds"] + summary["rounds_void"] > 0
    for traffic, bill in summary["radio"]["traffic"].items():
        assert scraped("payload_bits_total", traffic=traffic) == summary["payload_bits"][traffic]
        assert scraped("wire_bytes_total", traffic=traffic) == bill["wire_bytes"]
        assert scraped("link_copies_total", traffic=traffic) == bill["sent"]
        assert scraped("deliveries_total", traffic=traffic) == bill["delivered"]
        assert scraped("outages_total", traffic=traffic) == bill["outages"]
    assert summary["radio"]["outages"] > 0
    assert scraped("uavs", status="lost") == summary["lost"] == 1
    assert scraped("uavs", status="arrived") == summary["arrived"]
    assert scraped("uavs", status="flying") == 6 - summary["arrived"] - summary["lost"]
    assert summary["dropped_messages"] == {"malformed": 1, "unknown-node": 1}
    for reason, count in summary["dropped_messages"].items():
        assert scraped("dropped_messages_total", reason=reason) == count
    assert scraped("telemetry_blocks_unacknowledged") == 7
    assert scraped("held_commands_total") == scraped("deadline_misses_total") == 0
    assert scraped("run_info", run=RUN, mode="processes", method="mfgfl-hf", version=summary["version"]) == 1
    for name in ("tick_seconds", "barrier_wait_seconds"):
        buckets = [scraped(f"{name}_bucket", le=f"{bound:g}") for bound in BOUNDS_S]
        assert buckets == sorted(buckets)
        assert buckets[-1] <= scraped(f"{name}_bucket", le="+Inf") == scraped(f"{name}_count") == 120
    assert 0.0 < scraped("barrier_wait_seconds_sum") < scraped("tick_seconds_sum") < engine.watch.seconds
    assert {"process_resident_memory_bytes", "process_cpu_seconds"} <= {family.name for family in scraped.families}
    for family in scraped.families:
        assert family.documentation
        assert family.name.startswith(("meanflock_", "process_"))
        assert family.type in ("counter", "gauge", "histogram")


def test_unknown_metrics_are_absent_and_nodes_are_counted_as_they_come_and_go(engine: MemorySwarm, url: str) -> None:
    before = Scrape(url)
    assert before("ticks_total") == 0
    assert "meanflock_real_time_factor" not in {sample.name for family in before.families for sample in family.samples}
    assert [before("nodes_alive", role=role) for role in ("world", "leader", "agent", "station")] == [1, 1, 3, 1]
    flight = engine.fly()
    next(flight)
    (bus,) = (bus for bus in engine.network.endpoints if keys.sense(RUN, "agent-2") in bus._subscriptions)
    bus.close()
    next(flight)
    after = Scrape(url)
    assert after("nodes_alive", role="agent") == 2
    assert after("nodes_lost_total") == 1
    assert after("uavs", status="lost") == 2
    assert after("real_time_factor") > 0.0
