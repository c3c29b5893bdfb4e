"""Flags, addresses, signals and restarts of the processes; their log as text and as JSON."""

import json
import logging
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from meanflock.net import keys
from meanflock.net.access import Address
from meanflock.net.process import AT_MOST, QUICK_S, Restarts, parser, seconds
from meanflock.swarm import logs
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import load
from tests.commands import printed
from tests.memory_swarm import MemorySwarm


@pytest.mark.parametrize("text", ["nan", "-1", "soon"])
def test_a_flag_rejects_a_value_that_is_no_time(text: str) -> None:
    with pytest.raises(BadInput, match=r"^--wait .*: seconds, at least 0, for example --wait 30$"):
        parser("agent", "what", "example").parse_args([f"--wait={text}"])
    assert seconds("--barrier", 0.1)("0.1") == 0.1
    with pytest.raises(BadInput, match=r"at least 0\.1"):
        seconds("--barrier", 0.1)("0")


def test_a_wrong_command_line_is_an_error_that_names_the_help(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        parser("agent", "what", "example").parse_args(["--bogus"])
    assert left.value.code == 2
    assert capsys.readouterr().err == "error: unrecognized arguments: --bogus; see python -m meanflock.agent --help\n"


def test_a_long_life_makes_up_for_short_ones_before_it() -> None:
    now = [0.0]
    restarts = Restarts(lambda: now[0])
    for life_s in 2 * [*[QUICK_S] * (2 * AT_MOST), *[1.0] * (AT_MOST - 1)]:
        restarts.started("a")
        now[0] += life_s
        assert restarts.again("a")
    restarts.started("a")
    assert not restarts.again("a")


@pytest.mark.parametrize(
    ("text", "host", "port", "shown"),
    [
        ("9464", "127.0.0.1", 9464, "127.0.0.1:9464"),
        ("world:65535", "world", 65535, "world:65535"),
        ("[::1]:0", "::1", 0, "[::1]:0"),
    ],
)
def test_a_port_is_of_this_machine_unless_there_is_a_host(text: str, host: str, port: int, shown: str) -> None:
    address = Address.parse("--metrics", text)
    assert address == (host, port)
    assert str(address) == shown


@pytest.mark.parametrize("text", ["", ":", ":80", "host", "host:", "-1", "65536", "80.5", "٣", "host:eighty"])
def test_a_text_that_is_no_address_is_named_with_its_flag(text: str) -> None:
    with pytest.raises(BadInput, match=r"--metrics .*HOST:PORT"):
        Address.parse("--metrics", text)


RUN = "logged"


@pytest.fixture(autouse=True)
def _stop() -> Iterator[None]:
    yield
    logs.stop()


def record(message: str, error: Any = None, **extra: object) -> logging.LogRecord:
    entry = logging.LogRecord("meanflock.test", logging.WARNING, __file__, 1, "%s", (message,), error)
    entry.__dict__.update(extra)
    return entry


@given(st.text(), st.dictionaries(st.sampled_from(logs.FIELDS), st.text() | st.integers() | st.lists(st.integers())))
def test_any_message_is_one_line_of_json_or_of_text_that_steers_no_terminal(text: str, extra: dict[str, Any]) -> None:
    line = logs.JsonLines({"run": text, "node": "world"}).format(record(text, **extra))
    assert len(line.splitlines()) == 1
    read = json.loads(line)
    assert read.pop("time").endswith("+00:00")
    said = {"level": "WARNING", "logger": "meanflock.test", "message": text, "run": text, "node": "world"}
    assert read == said | extra
    line = logs.TextLines().format(record(text))
    assert line.isprintable()
    assert line.endswith(f" meanflock.test WARNING {text}") or not text.isprintable()


def test_no_line_of_a_traceback_looks_like_one_of_the_log() -> None:
    try:
        raise ValueError("broken\n2026-01-01 meanflock.world WARNING lost agent-1\x1b[2J")
    except ValueError:
        failed = record("failed", sys.exc_info())
    first, *rest = logs.TextLines().format(failed).split("\n")
    assert first.endswith("WARNING failed")
    assert all(line.startswith("    ") and line.isprintable() for line in rest)
    (line,) = logs.JsonLines({}).format(failed).splitlines()
    assert "ValueError: broken" in json.loads(line)["exception"]


def lines(capsys: pytest.CaptureFixture[str]) -> list[dict[str, Any]]:
    return [json.loads(line) for line in capsys.readouterr().err.splitlines()]


def test_a_text_for_the_user_is_written_at_any_level_in_the_form_of_the_log(capsys, monkeypatch) -> None:
    monkeypatch.setenv("MEANFLOCK_LOG", "error")
    logs.start("text", run=RUN)
    logs.show("said")
    assert capsys.readouterr().err == "said\n"
    logs.start("json", run=RUN)
    logs.show("said")
    (read,) = lines(capsys)
    assert (read["message"], read["level"], read["run"]) == ("said", "INFO", RUN)


def test_an_unknown_form_or_level_is_bad_input(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(BadInput, match="--log-format xml: choose text or json"):
        logs.start("xml")
    monkeypatch.setenv("MEANFLOCK_LOG", "loud")
    with pytest.raises(BadInput, match=r"MEANFLOCK_LOG=LOUD.*WARNING"):
        logs.start("text")


def test_the_world_and_a_node_log_the_reason_of_a_drop_and_of_a_loss(capsys: pytest.CaptureFixture[str]) -> None:
    logs.start("json", run=RUN, node="world")
    engine = MemorySwarm(load(None, ["uavs=4", "duration=2", "method=mfg"]), RUN, uavs_per_node=2)
    network = engine.network.endpoint()
    (doomed,) = (bus for bus in engine.network.endpoints if keys.sense(RUN, "agent-2") in bus._subscriptions)
    for tick in engine.fly():
        if tick == 3:
            network.put(keys.act(RUN, "agent-0"), b"nonsense")
            network.put(keys.sense(RUN, "agent-0"), b"\x00")
        if tick == 5:
            doomed.close()
    dropped, node, lost = lines(capsys)
    expected = {"tick": 3, "peer": "agent-0", "reason": "malformed", "level": "WARNING"}
    expected |= {"logger": "meanflock.world", "run": RUN, "node": "world"}
    assert {name: dropped[name] for name in expected} == expected
    assert (node["logger"], node["tick"], node["reason"]) == ("meanflock.node", 2, "malformed")
    assert (lost["tick"], lost["peer"], lost["uavs"]) == (5, "agent-2", [2, 3])
    assert lost["reason"] == "its liveliness token vanished"


def test_a_fork_that_ends_at_once_is_not_waited_for() -> None:
    made = "import time\nfrom meanflock.launch.forks import Forks\nforks = Forks()\n"
    printed(sys.executable, "-c", f"{made}if forks.fork(0):\n    time.sleep(1e4)\nforks.end_all(1e4)")


def test_a_process_whose_threads_have_ended_may_fork_and_one_with_a_thread_may_not() -> None:
    program = """
import threading
from meanflock.launch.forks import is_alone
def join():
    thread = threading.Thread(target=lambda: None)
    thread.start()
    thread.join()
print(all(join() is None and is_alone() for _ in range(1000)))
threading.Thread(target=threading.Event().wait, daemon=True).start()
print(is_alone())
"""
    assert printed(sys.executable, "-c", program).split() == ["True", "False"]


def test_a_process_ends_with_its_code_after_its_threads_and_what_is_registered_for_its_end() -> None:
    program = """
import atexit, threading, time
from meanflock.swarm.ending import end
atexit.register(print, "left")
threading.Thread(target=lambda: (time.sleep(0.2), print("slept"))).start()
end(3)
"""
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout, ended.stderr) == (3, "slept\nleft\n", "")
