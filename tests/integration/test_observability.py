"""Real processes, watched: scraped, their logs read as JSON, kept to the wall clock, and with that clock astray."""

import json
import re
import shutil
import signal
import socket
import subprocess
import urllib.request
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import psutil
import pytest
from prometheus_client.parser import text_string_to_metric_families

from meanflock.groundstation.cli import main
from meanflock.groundstation.engine import Engine
from meanflock.groundstation.launch import free_endpoint
from meanflock.groundstation.results import CHECKPOINT
from meanflock.groundstation.resume import back
from meanflock.groundstation.station import Station
from meanflock.swarm.net.session import ZenohBus
from meanflock.swarm.scenario import load
from tests.integration.conftest import Command, Spawn, processes_of
from tests.polling import DEADLINE_S, until

pytestmark = pytest.mark.processes

SHORT = ("--uavs", "3", "--seed", "7", "--duration", "30", "--set", "federation.period=40", "--no-record")
ENDLESS = ("--duration", "100000", "--set", "stop=duration")
SETTINGS = ("uavs=3", "seed=7", "duration=30", "federation.period=40")


def scrape(url: str) -> dict[tuple[str, frozenset[tuple[str, str]]], float]:
    with urllib.request.urlopen(url, timeout=DEADLINE_S) as answer:
        families = text_string_to_metric_families(answer.read().decode())
        return {(s.name, frozenset(s.labels.items())): s.value for family in families for s in family.samples}


def told_url(stream: Iterable[str]) -> str:
    """The address a process says it can be read at."""
    for line in stream:
        if found := re.search(r"metrics at (http://127\.0\.0\.1:\d+/metrics)", line):
            return found[1]
    raise AssertionError("no address was told")


def world(spawn: Spawn, *flags: str) -> tuple["subprocess.Popen[str]", tuple[str, ...]]:
    base = ("--endpoint", free_endpoint(), "--run", "watched")
    sets = (word for setting in SETTINGS for word in ("--set", setting))
    return spawn("meanflock.worldsim", *base, *sets, *flags), base


def listening(pid: int) -> set[int]:
    connections = psutil.Process(pid).net_connections(kind="tcp")
    return {connection.laddr.port for connection in connections if connection.status == psutil.CONN_LISTEN}


# -- metrics --------------------------------------------------------------------------------------------------------


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
        # It acknowledges nothing yet, so the world that has flown stays for its last words.
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


def test_the_whole_command_can_be_read_while_it_flies_and_nobody_listens_afterwards(command: Command) -> None:
    process = command.start(*SHORT, *ENDLESS, "--metrics", "0", "--json", "--quiet")
    assert process.stderr is not None
    url = told_url(process.stderr)

    def reading() -> dict[Any, float]:
        try:
            return scrape(url)
        except OSError:  # the world is not up yet
            return {}

    until(lambda: reading().get(("meanflock_ticks_total", frozenset()), 0) > 0, "a tick in the metrics")
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=DEADLINE_S)
    assert "interrupted" in err
    assert json.loads((command.folder / "summary.json").read_text())["ticks"] > 0
    with pytest.raises(OSError, match="refused"):
        scrape(url)


def test_a_run_that_goes_on_can_be_read_and_says_everything_in_json(command: Command, spawn: Spawn) -> None:
    dead = command.start(*SHORT, *ENDLESS, "--json", "--quiet")
    until(lambda: list(command.out.glob(f"*/{CHECKPOINT}")), "a checkpoint")
    dead.kill()
    dead.communicate()
    begin = back(command.folder).start.tick
    flags = ("--metrics", "0", "--log-format", "json", "--no-record", "--json")
    process = spawn("meanflock.groundstation.cli", "resume", str(command.folder), *flags)
    assert process.stderr is not None
    first = process.stderr.readline()
    url = told_url(iter([first]))
    until(lambda: scrape(url)["meanflock_ticks_total", frozenset()] > begin + 20, "ticks beyond the checkpoint")
    process.send_signal(signal.SIGINT)
    _, rest = process.communicate(timeout=DEADLINE_S)
    said = [json.loads(line) for line in (first + rest).splitlines()]
    assert {line["run"] for line in said} == {command.folder.name}
    assert "interrupted" in said[-1]["message"]
    assert process.returncode == 1


def test_no_port_is_open_unless_it_was_asked_for(spawn: Spawn) -> None:
    plain, base = world(spawn)
    bus_port = int(base[1].rpartition(":")[2])
    assert until(lambda: listening(plain.pid), "the bus") == {bus_port}
    watched, base = world(spawn, "--metrics", "0")
    assert watched.stderr is not None
    metrics_port = int(told_url(watched.stderr).removesuffix("/metrics").rpartition(":")[2])
    assert listening(watched.pid) == {int(base[1].rpartition(":")[2]), metrics_port}


@pytest.mark.parametrize("flags", [(), ("--in-process",)])
def test_a_port_that_is_taken_is_bad_input_and_nothing_is_written(
    flags: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        taken = f"127.0.0.1:{server.getsockname()[1]}"
        code = main(["run", *SHORT, *flags, "--out", str(tmp_path / "runs"), "--quiet", "--metrics", taken])
    err = capsys.readouterr().err
    assert code == 2
    assert err.startswith(f"error: --metrics {taken}: ")
    assert err.count("\n") == 1
    assert not (tmp_path / "runs").exists()


def test_a_world_whose_port_is_taken_ends_before_it_listens(spawn: Spawn) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        taken, _ = world(spawn, "--metrics", str(server.getsockname()[1]), "--log-format", "json")
        _, err = taken.communicate(timeout=DEADLINE_S)
    assert taken.returncode == 2
    (line,) = err.splitlines()
    said = json.loads(line)
    assert (said["level"], said["node"], said["run"]) == ("ERROR", "world", "watched")
    assert "--metrics" in said["message"]


# -- logs -----------------------------------------------------------------------------------------------------------


def test_every_line_of_a_run_is_an_object_that_says_who_and_when(
    command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MEANFLOCK_LOG", "INFO")
    monkeypatch.setenv("MEANFLOCK_LOG_FORMAT", "json")
    process = command.start(*SHORT, "--json")
    out, err = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 0, err
    run = json.loads(out)["run_id"]
    said = [json.loads(line) for line in err.splitlines()]
    assert all({"time", "level", "logger", "message"} <= line.keys() for line in said)
    assert {(line["run"], line["node"]) for line in said} == {(run, "world")}
    joined = {line["peer"]: line["uavs"] for line in said if "joined" in line["message"]}
    assert joined == {"agent-0": [0], "agent-1": [1], "agent-2": [2], "leader": []}


def test_a_process_that_fails_says_so_in_one_line(spawn: Spawn) -> None:
    base = ("--endpoint", free_endpoint(), "--run", "nobody", "--wait", "1", "--log-format", "json")
    started = {module: spawn(f"meanflock.{module}", *base) for module in ("agent", "leader", "groundstation")}
    for module, process in started.items():
        _, err = process.communicate(timeout=DEADLINE_S)
        assert process.returncode == 1
        (line,) = err.splitlines()
        said = json.loads(line)
        node = {"groundstation": "station"}.get(module, module)
        assert (said["level"], said["run"], said["node"]) == ("ERROR", "nobody", node)


# -- real time ------------------------------------------------------------------------------------------------------


def test_real_time_is_kept_and_what_was_late_is_counted(command: Command) -> None:
    summary = command.summary(*SHORT, "--realtime=15")
    assert 2.0 <= summary["wall_time_s"] < DEADLINE_S  # 30 s, 15 times faster; a busy machine may come late
    assert summary["real_time_factor"] == pytest.approx(30.0 / summary["wall_time_s"])
    kept = summary["realtime"]
    assert kept["factor"] == 15.0
    assert 0 <= kept["deadline_misses"] <= summary["held_commands"] <= 3 * 300
    assert kept["deadline_misses"] <= 300
    jitter = kept["tick_start_jitter_ms"]
    assert 0.0 <= jitter["mean"] <= jitter["max"]
    assert 0.0 < jitter["p99"] <= jitter["max"]


def test_an_agent_that_is_stopped_for_a_moment_is_late_and_not_lost(spawn: Spawn) -> None:
    endless = ("--set", "duration=100000", "--set", "stop=duration")
    flown, base = world(spawn, *endless, "--realtime", "10", "--metrics", "0")
    spawn("meanflock.leader", *base)
    agents = [spawn("meanflock.agent", *base) for _ in range(3)]
    assert flown.stderr is not None
    url = told_url(flown.stderr)
    count = lambda name: scrape(url)[f"meanflock_{name}_total", frozenset()]  # noqa: E731
    until(lambda: count("ticks") > 20, "the flight")
    slow = psutil.Process(agents[0].pid)
    before = count("deadline_misses")
    slow.suspend()
    try:
        until(lambda: count("deadline_misses") >= before + 3, "late ticks")
    finally:
        slow.resume()
    flown.send_signal(signal.SIGINT)
    out, err = flown.communicate(timeout=DEADLINE_S)
    assert "interrupted" in err
    summary = json.loads(out)
    assert summary["lost"] == summary["nodes_lost"] == 0
    assert summary["realtime"]["deadline_misses"] >= 3
    assert summary["held_commands"] >= 3


# -- the wall clock -------------------------------------------------------------------------------------------------

IN_PYTHON = """
import itertools, time
_hours, _time, _time_ns = itertools.cycle((0, 5, -30, 1, -2, 100, -9)), time.time, time.time_ns
time.time = lambda: _time() + 3600 * next(_hours)
time.time_ns = lambda: _time_ns() + 3600 * 10**9 * next(_hours)
"""
IN_C = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdatomic.h>
#include <sys/time.h>
#include <time.h>

static long jump(void) {
    static atomic_uint calls;
    static const long hours[] = {0, 5, -30, 1, -2, 100, -9};
    return 3600 * hours[atomic_fetch_add(&calls, 1) % 7];
}

int clock_gettime(clockid_t clock, struct timespec *now) {
    int (*real)(clockid_t, struct timespec *) = dlsym(RTLD_NEXT, "clock_gettime");
    int failed = real(clock, now);
    if (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE) now->tv_sec += jump();
    return failed;
}

int gettimeofday(struct timeval *now, void *zone) {
    int (*real)(struct timeval *, void *) = dlsym(RTLD_NEXT, "gettimeofday");
    int failed = real(now, zone);
    now->tv_sec += jump();
    return failed;
}

time_t time(time_t *now) {
    time_t (*real)(time_t *) = dlsym(RTLD_NEXT, "time");
    time_t shown = real(NULL) + jump();
    if (now) *now = shown;
    return shown;
}
"""


def set_astray(how: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From now on, each look of a child at the wall clock finds it hours away from the last one."""
    if how == "python":
        (folder / "sitecustomize.py").write_text(IN_PYTHON)
        monkeypatch.setenv("PYTHONPATH", str(folder))
        return
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler, so native code cannot be shown another clock")
    (folder / "jump.c").write_text(IN_C)
    library = folder / "jump.so"
    subprocess.run([compiler, "-shared", "-fPIC", "-o", library, folder / "jump.c", "-ldl"], check=True)
    monkeypatch.setenv("LD_PRELOAD", str(library))


@pytest.mark.parametrize("how", ["python", "native"])
def test_a_wall_clock_that_jumps_by_hours_changes_nothing(
    how: str, command: Command, spawn: Spawn, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`native`: for everything in the process that asks the C library, Zenoh included."""
    engine = Engine(load(None, SETTINGS), "calm")
    for _ in engine.fly():
        pass
    calm = engine.world.finish()
    set_astray(how, tmp_path, monkeypatch)
    monkeypatch.setenv("MEANFLOCK_LOG", "INFO")
    flags = ("--json", "--log-format", "json", *SHORT)
    astray = command.start(*flags)
    out, err = astray.communicate(timeout=DEADLINE_S)
    assert astray.returncode == 0, err
    said = [json.loads(line) for line in err.splitlines()]
    # The world joined four nodes within a few seconds, at hours all over the week: the clock really did jump.
    others = [line for line in said if "joined" not in line["message"]]
    assert len(said) == 4 + len(others)
    assert len({line["time"][:13] for line in said}) >= 3
    summary = json.loads(out)
    assert not others
    timing = ("wall_time_s", "real_time_factor", "mode", "run_id", "wire_bytes", "radio")
    assert {k: v for k, v in summary.items() if k not in timing} == {k: v for k, v in calm.items() if k not in timing}
    assert 0.0 < summary["wall_time_s"] < DEADLINE_S
    assert processes_of(summary["run_id"]) == []
    if how == "native":
        kept = Command(tmp_path / "kept", spawn).summary(*SHORT, "--realtime=15")
        assert 2.0 <= kept["wall_time_s"] < DEADLINE_S
        assert 0.0 <= kept["realtime"]["tick_start_jitter_ms"]["max"] < 1e3 * DEADLINE_S
        assert kept["lost"] == 0
