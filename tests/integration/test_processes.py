"""Flights of processes over Zenoh, started by the command, by hand and in another language; metrics and JSON logs."""

import json
import re
import signal
import subprocess
import sys
from collections import Counter
from pathlib import Path

import psutil
import pyarrow.parquet as pq
import pytest

from meanflock.groundstation.launch.engine import Engine
from meanflock.groundstation.launch.processes import free_endpoint
from meanflock.groundstation.recording.replay import verify
from meanflock.swarm import plugins
from meanflock.swarm.scenario import load
from tests.golden.flights import read, steady
from tests.integration.conftest import ENDLESS, WATCHED, Command, Spawn, processes_of, scrape, told_url, world
from tests.polling import DEADLINE_S, until

pytestmark = pytest.mark.processes

SHORT = ("--uavs", "4", "--seed", "7", "--duration", "30", "--set", "federation.period=40")

CUTS = [  # flights of the golden table, and UAVs of a process; `short-quiet` has bytes, events and a filter
    ("short-hjb", "3"),
    ("short-clusters-hf", "2"),
    ("short-quiet", "1"),
]


@pytest.mark.parametrize(("name", "rows"), CUTS)
def test_a_golden_flight_is_the_same_in_processes(name: str, rows: str, command: Command) -> None:
    (row,) = (row for row in read() if row.name == name)
    settings = [word for setting in row.settings for word in ("--set", setting)]
    summary = command.summary(*filter(None, [row.mission]), "--no-record", "--uavs-per-process", rows, *settings)
    assert summary["mode"] == "processes"
    assert summary["dropped_messages"] == {}
    assert steady(summary) == json.loads(json.dumps(steady(row.fly())))


def test_a_finished_run_leaves_all_five_files_and_reruns_bit_identically(command: Command, spawn: Spawn) -> None:
    first = command.summary_of_a_process(*SHORT)
    folder = command.folder
    names = {"scenario.toml", "summary.json", "timeseries.parquet", "events.jsonl", "recording.rrd"}
    assert {path.name for path in folder.iterdir()} == names
    assert json.loads((folder / "summary.json").read_text()) == first
    table = pq.read_table(folder / "timeseries.parquet")
    assert table["tick"].to_pylist() == list(range(first["ticks"] + 1))
    assert verify(folder / "recording.rrd") is None
    kinds = Counter(json.loads(line)["kind"] for line in (folder / "events.jsonl").read_text().splitlines())
    assert kinds["finished"] == 1
    assert kinds["round"] == first["rounds"] > 0
    again = Command(command.out.parent / "again", spawn).summary(str(folder / "scenario.toml"), "--in-process")
    assert again["trajectory_sha256"] == first["trajectory_sha256"]
    assert again["scenario_sha256"] == first["scenario_sha256"]
    assert processes_of(first["run_id"]) == []


def test_processes_started_by_hand_in_any_order_find_each_other(command: Command, spawn: Spawn, tmp_path: Path) -> None:
    base = ("--endpoint", free_endpoint(), "--run", "by-hand")
    others = [
        spawn("meanflock.agent", *base),
        spawn("meanflock.agent", *base, "--rows", "2"),
        spawn("meanflock.leader", *base),
    ]
    settings = ("uavs=4", "seed=7", "duration=30", "federation.period=40")
    flags = (flag for setting in settings for flag in ("--set", setting))
    world = spawn("meanflock.worldsim", *base, *flags, "--stations", "1")
    others.append(spawn("meanflock.agent", *base))
    station = spawn("meanflock.groundstation", *base, "--out", str(tmp_path / "recorded"), "--rerun", "")
    out, err = world.communicate(timeout=DEADLINE_S)
    assert world.returncode == 0, err
    for process in others:
        _, err = process.communicate(timeout=DEADLINE_S)
        assert process.returncode == 0, err
    told, err = station.communicate(timeout=DEADLINE_S)
    assert station.returncode == 0, err
    assert json.loads(told) == json.loads(out)
    (folder,) = (tmp_path / "recorded").iterdir()
    assert len(pq.read_table(folder / "timeseries.parquet")) == 301
    expected = command.summary("--in-process", "--no-record", *SHORT)
    assert json.loads(out)["trajectory_sha256"] == expected["trajectory_sha256"]


def test_agents_forked_by_hand_end_with_the_process_that_forked_them(spawn: Spawn) -> None:
    base = ("--endpoint", free_endpoint(), "--run", "three-of-one")
    flags = ("--set", "uavs=6", "--set", "method=mfg", "--set", "stop=duration", "--set", "duration=100000")
    world = spawn("meanflock.worldsim", *base, *flags)
    agents = spawn("meanflock.agent", *base, "--count", "3", "--rows", "2")
    spawn("meanflock.leader", *base)
    until(
        lambda: len(processes_of("three-of-one")) == 6, "world, leader, three agents and the process that forked them"
    )
    frozen = psutil.Process(agents.pid).children()[1]
    frozen.suspend()
    agents.terminate()
    _, err = agents.communicate(timeout=DEADLINE_S)
    assert (agents.returncode, err) == (0, "")
    until(lambda: len(processes_of("three-of-one")) == 2, "all agents gone")
    world.terminate()
    world.communicate(timeout=DEADLINE_S)


def test_processes_keep_to_real_time(command: Command) -> None:
    paced = command.summary_of_a_process(*SHORT, "--no-record", "--realtime=15")
    assert 2.0 <= paced["wall_time_s"] < DEADLINE_S  # 30 s, 15 times faster; a busy machine may be late
    assert paced["real_time_factor"] == pytest.approx(30.0 / paced["wall_time_s"])
    kept, jitter = paced["realtime"], paced["realtime"]["tick_start_jitter_ms"]
    assert (kept["factor"], paced["lost"]) == (15.0, 0)
    assert 0 <= kept["deadline_misses"] <= min(300, paced["held_commands"])
    assert 0.0 <= jitter["mean"] <= jitter["max"] < 1e3 * DEADLINE_S
    assert 0.0 < jitter["p99"] <= jitter["max"]


def listening(pid: int) -> set[int]:
    connections = psutil.Process(pid).net_connections(kind="tcp")
    return {connection.laddr.port for connection in connections if connection.status == psutil.CONN_LISTEN}


def test_a_command_can_be_scraped_while_it_flies_and_logs_objects_that_say_who_and_when(
    command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MEANFLOCK_LOG", "INFO")
    process = command.start(*WATCHED, *ENDLESS, "--metrics", "0", "--json", "--log-format", "json")
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
    metrics_port = int(told_url(watched.stderr).removesuffix("/metrics").rpartition(":")[2])
    assert listening(watched.pid) == {int(base[1].rpartition(":")[2]), metrics_port}


EXAMPLES = Path(__file__).parents[2] / "examples"
AGENT, SPRING = EXAMPLES / "foreign_agent.py", EXAMPLES / "spring.py"
SETTINGS = ("method=spring", "uavs=3", "seed=5", "duration=30", 'stop="duration"', "radio.target_snr_db=77")
FOREIGN = 1  # the UAV that is not flown by us


def test_an_agent_of_another_language_flies_among_ours_to_the_same_bits(spawn: Spawn, monkeypatch) -> None:
    modules = set(re.findall(r"^(?:import|from) (\w+)", AGENT.read_text(encoding="utf-8"), flags=re.M))
    assert modules <= sys.stdlib_module_names | {"msgpack", "zenoh"}
    endpoint = free_endpoint()
    monkeypatch.setenv(plugins.FILES, str(SPRING))
    base = ("--run", "foreign", "--endpoint", endpoint, "--wait", str(int(DEADLINE_S)))
    world = spawn("worldsim", *base, *(flag for setting in SETTINGS for flag in ("--set", setting)))
    ours = [spawn("agent", *base, "--uav", str(uav)) for uav in range(3) if uav != FOREIGN]
    line = [sys.executable, "-I", str(AGENT), "foreign", endpoint, str(FOREIGN)]
    foreign = subprocess.run(line, capture_output=True, text=True, timeout=DEADLINE_S, check=False)
    assert foreign.stdout.strip() == "finished 299", foreign.stderr
    out, err = world.communicate(timeout=DEADLINE_S)
    assert world.returncode == 0, err
    summary = json.loads(out)
    assert [process.wait(DEADLINE_S) for process in ours] == [0, 0]
    assert (summary["lost"], summary["nodes_lost"], summary["dropped_messages"]) == (0, 0, {})

    plugins.load_file(SPRING)
    alone = Engine(load(None, SETTINGS), "foreign").complete()
    assert summary["trajectory_sha256"] == alone["trajectory_sha256"]
    assert summary["payload_bits"] == alone["payload_bits"]
    assert alone["radio"]["traffic"]["state"]["sent"] == 300 * 3 * 2
    assert alone["radio"]["traffic"]["state"]["outages"] > 0
