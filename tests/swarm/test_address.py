"""Hosts and ports of the command line."""

import pytest

from meanflock.swarm.errors import BadInput
from meanflock.swarm.net.access import Address


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
