"""Hosts and ports of the command line."""

import pytest

from meanflock.swarm.errors import BadInput
from meanflock.swarm.net.access import Address, check_free


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


@pytest.mark.parametrize("host", ["127.0.0.1", "::1"])
def test_a_free_port_can_be_had_and_a_taken_one_is_refused(host: str) -> None:
    try:
        free = Address(host, 0).free("--metrics")
    except BadInput:
        pytest.skip("this machine has no such address")
    check_free(f"tcp/{free}")
    with free.listen():
        with pytest.raises(BadInput, match=rf"--metrics .*:{free.port}: Address already in use; choose"):
            free.free("--metrics")
        with pytest.raises(BadInput, match=r"Address already in use.*choose a free one"):
            check_free(f"tcp/{free}")


def test_an_address_of_another_machine_is_refused() -> None:
    with pytest.raises(BadInput, match=r"192.0.2.1:0: Cannot assign requested address; choose"):
        Address("192.0.2.1", 0).free("--metrics")
