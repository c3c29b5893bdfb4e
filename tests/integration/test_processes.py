"""Flights of processes over Zenoh, started by the command, by hand and in another language; metrics and JSON logs."""

import json
import re
import shutil
import signal
import sys
import urllib.request
from collections.abc import Iterable
from pathlib import Path

import psutil
import pytest

from meanflock.launch.engine import Engine
from meanflock.recording.replay import verify
from meanflock.results.event_log import event_of_row
from meanflock.swarm import plugins
from meanflock.swarm.scenario import load
from tests.commands import printed
from tests.faults import drawing, troubled
from tests.faults.by_hand import Processes, ends_by_itself, events_in, ticks_of
from tests.golden.flights import read, steady
from tests.integration.conftest import Command, processes_of
from tests.polling import DEADLINE_S, until
from tests.telemetry import comparable, fly

pytestmark = pytest.mark.processes

EXAMPLE = Path(__file__).parents[2] / "examples" / "trace.parquet"
SETTINGS = ("seed=7", "duration=30", "federation.period=40")
SHORT = ("--uavs", "4", *(word for setting in SETTINGS for word in ("--set", setting)))

# Flights of the golden table, UAVs of a process, where the world listens; `short-quiet` has bytes, events and a filter.
CUTS = [
    ("short-hjb", "3", ()),
    ("short-clusters-hf", "2", ("--endpoint", "tcp/127.0.0.1:0")),
    ("short-csma", "2", ()),
    ("short-bands", "3", ()),
    ("short-mast", "2", ()),
    ("short-stations", "1", ()),
    ("short-space-braking", "2", ()),
    ("short-space-quadrotor", "2", ()),
    ("short-quiet", "1", ("--endpoint", "unixsock-stream/world.socket")),
]


def test_a_trace_is_flown_the_same_in_processes_and_from_another_place(command, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(EXAMPLE, "way.parquet")
    chosen = ("--method", "mfgfl-h", "--duration", "15", "--set", "vehicle.model=trace", "--no-record")
    mine, ours = (("--set", f"vehicle.options.file={path}") for path in ("way.parquet", EXAMPLE))
    split = command.summary(*chosen, *mine, "--uavs-per-process", "9")
    assert steady(split) == steady(command.summary(*chosen, *ours, "--in-process"))


@pytest.mark.parametrize(("name", "rows", "endpoint"), CUTS)
def test_a_golden_flight_is_the_same_in_processes(name, rows, endpoint, command, tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)  # the path of a socket must be short
    (row,) = (row for row in read() if row.name == name)
    settings = [word for setting in row.settings for word in ("--set", setting)]
    mission = filter(None, [row.mission])
    summary = command.summary(*mission, "--no-record", "--uavs-per-process", rows, *settings, *endpoint)
    told = re.findall(r"the world listens at tcp/127.0.0.1:[1-9]\d*\n", capsys.readouterr().err)
    assert len(told) == (endpoint[-1:] == ("tcp/127.0.0.1:0",))
    assert [path.name for path in tmp_path.iterdir()] == ["runs"]
    assert summary["mode"] == "processes"
    assert summary["dropped_messages"] == {}
    assert steady(summary) == json.loads(json.dumps(steady(row.fly())))


@pytest.mark.parametrize("rows", ["1", "2"])
def test_events_of_a_flight_in_which_much_fails_are_those_of_one_process(rows: str, command: Command) -> None:
    plugins.register(troubled.Troubled)
    expected = fly(load(None, list(troubled.SETTINGS), method="troubled"))[1].events
    settings = [word for setting in troubled.SETTINGS for word in ("--set", setting)]
    chosen = ("--plugin", troubled.__file__, "--method", "troubled", "--uavs-per-process", rows)
    command.summary(*chosen, "--no-record", *settings)
    events = [event_of_row(row) for row in events_in(command.folder)]
    assert comparable(events) == comparable(expected)


@pytest.mark.parametrize("key", ["method", "filter.kind", "vehicle.model", "federation.aggregation"])
def test_a_plugin_that_draws_from_a_global_generator_is_named_once_on_two_processes(key: str, command, capfd) -> None:
    settings = [word for setting in (*drawing.SETTINGS, f"{key}=draws") for word in ("--set", setting)]
    command.summary("--plugin", drawing.__file__, "--no-record", "--uavs-per-process", "2", *settings)
    (text,) = (row["text"] for row in events_in(command.folder) if row["kind"] == "random")
    assert "'draws' draws from a global random generator" in text
    assert capfd.readouterr().err.count(text) == 1


def test_a_finished_run_leaves_all_six_files_and_reruns_bit_identically(command, processes) -> None:
    first = json.loads(ends_by_itself(command.start("--json", "--quiet", *SHORT)))
    folder = command.folder
    names = {"scenario.toml", "summary.json", "timeseries.parquet", "rounds.parquet", "events.jsonl", "recording.rrd"}
    assert {path.name for path in folder.iterdir()} == names
    assert json.loads((folder / "summary.json").read_text()) == first
    assert ticks_of(folder) == list(range(first["ticks"] + 1))
    assert verify(folder / "recording.rrd") is None
    assert command.count("finished") == 1
    assert command.count("round") == first["rounds"] > 0
    again = Command(command.out.parent / "again", processes).summary(str(folder / "scenario.toml"), "--in-process")
    assert again["trajectory_sha256"] == first["trajectory_sha256"]
    assert again["scenario_sha256"] == first["scenario_sha256"]
    assert processes_of(str(command.out.parent)) == []


def test_processes_started_by_hand_in_any_order_find_each_other(command, processes, tmp_path) -> None:
    others = [processes.start("agent"), processes.start("agent", "--rows", "2"), processes.start("leader")]
    world = processes.world("--stations", "1", settings=("uavs=4", *SETTINGS))
    others.append(processes.start("agent"))
    station = processes.station(tmp_path / "recorded")
    summary = json.loads(ends_by_itself(world))
    for process in others:
        ends_by_itself(process)
    assert json.loads(ends_by_itself(station)) == summary
    (folder,) = (tmp_path / "recorded").iterdir()
    assert len(ticks_of(folder)) == 301
    expected = command.summary("--in-process", "--no-record", *SHORT)
    assert summary["trajectory_sha256"] == expected["trajectory_sha256"]


def test_agents_forked_by_hand_end_with_the_process_that_forked_them(processes: Processes) -> None:
    run = processes.base[3]
    world = processes.world(settings=("uavs=6", "method=mfg", "stop=duration", "duration=100000"))
    agents = processes.start("agent", "--count", "3", "--rows", "2")
    processes.start("leader")
    until(lambda: len(processes_of(run)) == 6, "world, leader, three agents and the process that forked them")
    psutil.Process(agents.pid).children()[1].suspend()
    agents.terminate()
    assert agents.communicate(timeout=DEADLINE_S)[1] == ""
    assert agents.returncode == 0
    until(lambda: len(processes_of(run)) == 2, "all agents gone")
    world.terminate()
    world.communicate(timeout=DEADLINE_S)


def listening(pid: int) -> set[int]:
    connections = psutil.Process(pid).net_connections(kind="tcp")
    return {connection.laddr.port for connection in connections if connection.status == psutil.CONN_LISTEN}


def told_url(stream: Iterable[str]) -> str:
    """The address a process says it can be read at."""
    said = (re.search(r"metrics at (http://127\.0\.0\.1:\d+/metrics)", line) for line in stream)
    return next(found[1] for found in said if found)


def test_a_command_can_be_scraped_while_it_flies_and_logs_objects_that_say_who_and_when(command, monkeypatch) -> None:
    monkeypatch.setenv("MEANFLOCK_LOG", "INFO")
    endless = ("--uavs", "3", "--duration", "100000", "--set", "stop=duration", "--no-record")
    process = command.start(*endless, "--metrics", "0", "--json", "--log-format", "json")
    lines: list[str] = []
    url = told_url(line for line in process.stderr if lines.append(line) is None)

    def ticks() -> float:
        try:
            page = urllib.request.urlopen(url, timeout=DEADLINE_S).read().decode()
        except OSError:  # the world is not up yet
            return 0
        return float(re.search(r"^meanflock_ticks_total (\S+)$", page, flags=re.M)[1])

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
        urllib.request.urlopen(url, timeout=DEADLINE_S)


def test_no_port_is_open_unless_it_was_asked_for(processes: Processes) -> None:
    plain = processes.world()
    bus = {int(processes.base[1].rpartition(":")[2])}
    assert until(lambda: listening(plain.pid), "the bus") == bus
    plain.kill()
    plain.wait()
    watched = processes.world("--metrics", "0")
    metrics = {int(told_url(watched.stderr).removesuffix("/metrics").rpartition(":")[2])}
    assert listening(watched.pid) == bus | metrics


EXAMPLES = Path(__file__).parents[2] / "examples"
AGENT, SPRING = EXAMPLES / "foreign_agent.py", EXAMPLES / "spring.py"
SPRINGS = ("method=spring", "uavs=3", "seed=5", "duration=30", 'stop="duration"', "radio.target_snr_db=77")
FOREIGN = 1  # the UAV that is not flown by us


def test_an_agent_of_another_language_flies_among_ours_to_the_same_bits(processes: Processes, monkeypatch) -> None:
    modules = set(re.findall(r"^(?:import|from) (\w+)", AGENT.read_text(encoding="utf-8"), flags=re.M))
    assert modules <= sys.stdlib_module_names | {"msgpack", "zenoh"}
    monkeypatch.setenv(plugins.FILES, str(SPRING))
    world = processes.world(settings=SPRINGS)
    ours = [processes.start("agent", "--uav", str(uav)) for uav in range(3) if uav != FOREIGN]
    _, endpoint, _, run = processes.base
    assert printed(sys.executable, "-I", AGENT, run, endpoint, FOREIGN).strip() == "finished 299"
    summary = json.loads(ends_by_itself(world))
    assert [process.wait(DEADLINE_S) for process in ours] == [0, 0]
    assert (summary["lost"], summary["nodes_lost"], summary["dropped_messages"]) == (0, 0, {})

    plugins.load_file(SPRING)
    alone = Engine(load(None, SPRINGS), "foreign").complete()
    assert summary["trajectory_sha256"] == alone["trajectory_sha256"]
    assert summary["payload_bits"] == alone["payload_bits"]
    assert alone["radio"]["traffic"]["state"]["sent"] == 300 * 3 * 2
    assert alone["radio"]["traffic"]["state"]["outages"] > 0
