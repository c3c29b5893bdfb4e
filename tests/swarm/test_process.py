"""Flags, signals and restarts of the processes."""

import os
import signal

import pytest

from meanflock.swarm.errors import BadInput
from meanflock.swarm.process import AT_MOST, QUICK_S, Interrupted, Restarts, parser, seconds


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


def test_one_that_dies_at_once_is_started_a_few_times_only_and_nobody_else_is_blamed() -> None:
    restarts = Restarts(lambda: 0.0)
    for name in ("a", 7):
        restarts.started(name)
    assert [restarts.again("a") for _ in range(AT_MOST + 2)] == [True] * AT_MOST + [False] * 2
    assert restarts.again(7)


def test_one_that_lives_for_a_while_is_always_started_again() -> None:
    now = [0.0]
    restarts = Restarts(lambda: now[0])
    for _ in range(3 * AT_MOST):
        restarts.started("a")
        now[0] += QUICK_S
        assert restarts.again("a")


def test_a_longer_life_makes_up_for_the_short_ones_before_it() -> None:
    now = [0.0]
    restarts = Restarts(lambda: now[0])
    for life_s in [1.0] * AT_MOST + [QUICK_S] + [1.0] * (AT_MOST - 1):
        restarts.started("a")
        now[0] += life_s
        assert restarts.again("a")
    restarts.started("a")
    assert not restarts.again("a")
