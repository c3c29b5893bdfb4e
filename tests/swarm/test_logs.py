"""The log as JSON: one object a line whatever is in it, and where a drop or a loss says its reason."""

import json
import logging
import sys
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from meanflock.groundstation.launch.engine import Engine
from meanflock.swarm import logs
from meanflock.swarm.errors import BadInput
from meanflock.swarm.net import keys
from meanflock.swarm.scenario import load

RUN = "logged"


@pytest.fixture(autouse=True)
def _stop() -> Iterator[None]:
    yield
    logs.stop()


def record(message: str, *arguments: object, **extra: object) -> logging.LogRecord:
    made = logging.LogRecord("meanflock.test", logging.WARNING, __file__, 1, message, arguments, None)
    made.__dict__.update(extra)
    return made


def lines(capsys: pytest.CaptureFixture[str]) -> list[dict[str, Any]]:
    return [json.loads(line) for line in capsys.readouterr().err.splitlines()]


@given(st.text(), st.dictionaries(st.sampled_from(logs.FIELDS), st.text() | st.integers() | st.lists(st.integers())))
def test_whatever_is_said_it_is_one_line_and_comes_back_as_it_was(text: str, extra: dict[str, Any]) -> None:
    line = logs.JsonLines({"run": text, "node": "world"}).format(record("%s", text, **extra))
    assert len(line.splitlines()) == 1
    read = json.loads(line)
    assert read.pop("time").endswith("+00:00")
    said = {"level": "WARNING", "logger": "meanflock.test", "message": text, "run": text, "node": "world"}
    assert read == said | extra


@given(st.text())
def test_a_line_of_text_is_one_line_that_steers_no_terminal(text: str) -> None:
    line = logs.TextLines().format(record("%s", text))
    assert line.isprintable()
    if text.isprintable():
        assert line.endswith(f" meanflock.test WARNING {text}")


def test_no_line_of_a_traceback_looks_like_one_of_the_log() -> None:
    try:
        raise ValueError("broken\n2026-01-01 meanflock.world WARNING lost agent-1\x1b[2J")
    except ValueError:
        failed = logging.LogRecord("x", logging.ERROR, __file__, 1, "failed", (), sys.exc_info())
    first, *rest = logs.TextLines().format(failed).split("\n")
    assert first.endswith("x ERROR failed")
    assert all(line.startswith("    ") and line.isprintable() for line in rest)


def test_an_exception_is_a_field_of_its_line() -> None:
    try:
        raise ValueError("broken")
    except ValueError:
        failed = logging.LogRecord("x", logging.ERROR, __file__, 1, "failed", (), sys.exc_info())
    line = logs.JsonLines({}).format(failed)
    assert len(line.splitlines()) == 1
    assert "ValueError: broken" in json.loads(line)["exception"]


def test_what_is_known_of_a_process_later_is_in_the_lines_after(capsys: pytest.CaptureFixture[str]) -> None:
    known = logs.start("json", run=RUN, node="agent")
    log = logging.getLogger("meanflock.test")
    log.warning("first")
    known["node"] = "agent-3"
    log.warning("second")
    log.info("below the level")
    first, second = lines(capsys)
    assert (first["run"], first["node"], first["message"]) == (RUN, "agent", "first")
    assert (second["run"], second["node"], second["message"]) == (RUN, "agent-3", "second")


def test_starting_again_replaces_and_stopping_leaves_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    before = logging.root.handlers[:]
    logs.start("json")
    logs.start("text")
    logging.getLogger("meanflock.test").warning("once")
    assert capsys.readouterr().err.count("meanflock.test WARNING once") == 1
    logs.stop()
    assert logging.root.handlers == before


@pytest.mark.parametrize(("form", "says"), [("text", "said\n"), ("json", None)])
def test_what_must_be_said_is_said_in_the_form_of_the_log(
    form: str, says: str | None, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MEANFLOCK_LOG", "error")
    logs.start(form, run=RUN)
    logs.tell("said")
    err = capsys.readouterr().err
    if says is not None:
        assert err == says
    else:
        read = json.loads(err)
        assert (read["message"], read["level"], read["run"]) == ("said", "INFO", RUN)


def test_a_form_or_level_there_is_not_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(BadInput, match="--log-format xml: choose text or json"):
        logs.start("xml")
    monkeypatch.setenv("MEANFLOCK_LOG", "loud")
    with pytest.raises(BadInput, match=r"MEANFLOCK_LOG=LOUD.*WARNING"):
        logs.start("text")


def test_a_drop_and_a_loss_say_when_who_and_why(capsys: pytest.CaptureFixture[str]) -> None:
    logs.start("json", run=RUN, node="world")
    engine = Engine(load(None, ["uavs=4", "duration=2", "method=mfg"]), RUN, uavs_per_node=2)
    network = engine.network.endpoint()
    (doomed,) = (bus for bus in engine.network.endpoints if keys.sense(RUN, "agent-2") in bus._subscriptions)
    for tick in engine.fly():
        if tick == 3:
            network.put(keys.act(RUN, "agent-0"), b"nonsense")
        if tick == 5:
            doomed.close()
    dropped, lost = lines(capsys)
    assert {name: dropped[name] for name in ("tick", "peer", "reason", "level", "logger", "run", "node")} == {
        "tick": 3,
        "peer": "agent-0",
        "reason": "malformed",
        "level": "WARNING",
        "logger": "meanflock.world",
        "run": RUN,
        "node": "world",
    }
    assert (lost["tick"], lost["peer"], lost["uavs"]) == (5, "agent-2", [2, 3])
    assert lost["reason"] == "its liveliness token vanished"


def test_a_node_says_why_too(capsys: pytest.CaptureFixture[str]) -> None:
    logs.start("json")
    engine = Engine(load(None, ["uavs=2", "duration=2", "method=mfg"]), RUN)
    flight = engine.fly()
    next(flight)
    engine.network.endpoint().put(keys.sense(RUN, "agent-0"), b"\x00")
    (node,) = lines(capsys)
    assert (node["logger"], node["tick"], node["reason"]) == ("meanflock.node", 0, "malformed")
