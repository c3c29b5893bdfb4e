"""What the processes share on their command lines."""

import os
import signal

import pytest

from meanflock.swarm.errors import BadInput
from meanflock.swarm.process import Interrupted, parser, seconds


@pytest.mark.parametrize("text", ["nan", "inf", "-1", "soon", ""])
def test_a_time_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(BadInput, match=r"^--wait .*: seconds, at least 0, for example --wait 30$"):
        parser("agent", "what", "example").parse_args([f"--wait={text}"])


def test_a_time_has_a_least_value() -> None:
    assert seconds("--barrier", 0.1)("0.1") == 0.1
    with pytest.raises(BadInput, match=r"at least 0\.1"):
        seconds("--barrier", 0.1)("0")


def test_what_is_wrong_with_a_command_line_is_an_error_that_names_a_command_there_is(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit) as left:
        parser("agent", "what", "example").parse_args(["--bogus"])
    assert left.value.code == 2
    said = capsys.readouterr().err
    assert said == "error: unrecognized arguments: --bogus; see python -m meanflock.agent --help\n"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interruption_is_noted_for_as_long_as_somebody_looks_and_then_the_signal_is_whose_it_was(
    number: signal.Signals,
) -> None:
    heard: list[int] = []
    before = signal.signal(number, lambda number, _: heard.append(number))
    try:
        with Interrupted() as interrupted:
            assert not interrupted
            os.kill(os.getpid(), number)
            assert interrupted
        assert heard == []
        os.kill(os.getpid(), number)
        assert heard == [number]
    finally:
        signal.signal(number, before)
