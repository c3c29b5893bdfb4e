"""Flags, addresses, signals and restarts of the processes."""

import os
import signal

import pytest

from meanflock.swarm.errors import BadInput
from meanflock.swarm.net.access import Address
from meanflock.swarm.process import AT_MOST, QUICK_S, Interrupted, Restarts, parser, seconds


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


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interruption_is_noted_within_the_block_and_the_old_handler_comes_back(number: signal.Signals) -> None:
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
