"""Metrics and JSON logs of real processes."""

import json
import signal

import psutil
import pytest

from tests.integration.conftest import ENDLESS, SHORT, Command, Spawn, scrape, told_url, world
from tests.polling import DEADLINE_S, until

pytestmark = pytest.mark.processes


def listening(pid: int) -> set[int]:
    connections = psutil.Process(pid).net_connections(kind="tcp")
    return {connection.laddr.port for connection in connections if connection.status == psutil.CONN_LISTEN}


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
