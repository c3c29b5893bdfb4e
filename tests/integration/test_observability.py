"""Metrics and JSON logs of real processes."""

import json
import signal
import socket

import psutil
import pytest

from meanflock.groundstation.launch.processes import free_endpoint
from meanflock.groundstation.launch.station import Station
from meanflock.swarm.net.session import ZenohBus
from tests.integration.conftest import Command, Spawn
from tests.integration.watched import ENDLESS, SHORT, scrape, told_url, world
from tests.polling import DEADLINE_S, until

pytestmark = pytest.mark.processes


def listening(pid: int) -> set[int]:
    connections = psutil.Process(pid).net_connections(kind="tcp")
    return {connection.laddr.port for connection in connections if connection.status == psutil.CONN_LISTEN}


def test_a_scrape_of_a_real_run_is_its_summary(spawn: Spawn, command: Command) -> None:
    flown, base = world(spawn, "--metrics", "0", "--stations", "1")
    spawn("meanflock.leader", *base)
    spawn("meanflock.agent", *base, "--rows", "3")
    assert flown.stderr is not None
    url = told_url(flown.stderr)

    def alive(role: str) -> float:
        return scrape(url).get(("meanflock_nodes_alive", frozenset({("role", role)})), 0)

    until(lambda: alive("leader") == alive("agent") == 1, "both nodes, which wait for the station")
    bus = ZenohBus.client(base[1], DEADLINE_S)
    try:
        station = Station(bus, base[3], [])
        # The station acknowledges nothing yet, so the world waits after the last tick.
        until(lambda: scrape(url)["meanflock_ticks_total", frozenset()] == 300, "the last tick")
        seen = scrape(url)
        while station.summary is None:
            if delivery := bus.receive(DEADLINE_S):
                station.handle(delivery)
    finally:
        bus.close()
    out, err = flown.communicate(timeout=DEADLINE_S)
    assert flown.returncode == 0, err
    summary = json.loads(out)
    for traffic, bits in summary["payload_bits"].items():
        if traffic != "total":
            assert seen["meanflock_payload_bits_total", frozenset({("traffic", traffic)})] == bits
    assert summary["payload_bits"]["uplink"] > 0
    assert seen["meanflock_rounds_total", frozenset()] == summary["rounds"] > 0
    assert seen["meanflock_telemetry_blocks_unacknowledged", frozenset()] >= 300 // 50  # rows of a block, at the most
    assert seen["meanflock_nodes_alive", frozenset({("role", "station")})] == 1
    unwatched = command.summary("--in-process", *SHORT)
    assert summary["trajectory_sha256"] == unwatched["trajectory_sha256"]


def test_a_command_can_be_scraped_while_it_flies_and_logs_objects_that_say_who_and_when(
    command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MEANFLOCK_LOG", "INFO")
    process = command.start(*SHORT, *ENDLESS, "--metrics", "0", "--json", "--log-format", "json")
    assert process.stderr is not None
    lines: list[str] = []
    url = told_url(line for line in process.stderr if lines.append(line) is None)

    def ticks() -> float:
        try:
            return scrape(url).get(("meanflock_ticks_total", frozenset()), 0)
        except OSError:  # the world is not up yet
            return 0

    until(lambda: ticks() > 0, "a tick in the metrics")
    process.send_signal(signal.SIGINT)
    records = [json.loads(line) for line in (*lines, *process.stderr)]
    assert process.wait(DEADLINE_S) == 1
    assert "interrupted" in records[-1]["message"]
    assert all({"time", "level", "logger", "message"} <= record.keys() for record in records)
    assert {(record["run"], record["node"]) for record in records} == {
        (command.folder.name, node) for node in ("world", "station")
    }
    joined = {record["peer"]: record["uavs"] for record in records if "joined" in record["message"]}
    assert joined == {"agent-0": [0], "agent-1": [1], "agent-2": [2], "leader": []}
    assert json.loads((command.folder / "summary.json").read_text())["ticks"] > 0
    with pytest.raises(OSError, match="refused"):
        scrape(url)


def test_no_port_is_open_unless_it_was_asked_for(spawn: Spawn) -> None:
    plain, base = world(spawn)
    bus_port = int(base[1].rpartition(":")[2])
    assert until(lambda: listening(plain.pid), "the bus") == {bus_port}
    watched, base = world(spawn, "--metrics", "0")
    assert watched.stderr is not None
    metrics_port = int(told_url(watched.stderr).removesuffix("/metrics").rpartition(":")[2])
    assert listening(watched.pid) == {int(base[1].rpartition(":")[2]), metrics_port}


@pytest.mark.parametrize(
    ("node", "module", "flags", "code"),
    [
        ("agent", "agent", ("--wait", "1"), 1),
        ("leader", "leader", ("--wait", "1"), 1),
        ("station", "groundstation", ("--wait", "1"), 1),
        ("world", "worldsim", ("--metrics", "TAKEN"), 2),
    ],
)
def test_a_process_that_fails_logs_one_line(
    node: str, module: str, flags: tuple[str, ...], code: int, spawn: Spawn
) -> None:
    base = ("--endpoint", free_endpoint(), "--run", "nobody", "--log-format", "json")
    with socket.create_server(("127.0.0.1", 0)) as server:
        taken = str(server.getsockname()[1])
        process = spawn(f"meanflock.{module}", *base, *(flag.replace("TAKEN", taken) for flag in flags))
        _, err = process.communicate(timeout=DEADLINE_S)
    (line,) = err.splitlines()
    record = json.loads(line)
    assert (process.returncode, record["level"], record["run"], record["node"]) == (code, "ERROR", "nobody", node)
