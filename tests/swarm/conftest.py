"""What tests of `swarm` share: networks, and the forms of the reader and the writer of a tick's messages."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any, NamedTuple

import pytest
from meanflock.launch.processes import free_endpoint

from meanflock import kernels
from meanflock.kernels import reference, wire
from meanflock.net.bus import Bus, MemoryNetwork
from meanflock.net.session import ZenohBus


class Backend(NamedTuple):
    read: Callable[..., wire.Message]
    write: Callable[..., bytes]


REFERENCE = Backend(wire.read, wire.write)
BACKENDS: dict[str, Backend] = {"NumPy": Backend(reference.read, reference.write)}
with suppress(ImportError):  # where there was no C compiler
    from meanflock.kernels import compiled

    BACKENDS["compiled"] = Backend(compiled.read, compiled.write)


def outcome(call: Callable[..., Any], *given: Any) -> Any:
    try:
        return call(*given)
    except ValueError as error:
        return str(error).partition(":")[0]


Open = Callable[[], Bus]


@pytest.fixture(params=["memory", "zenoh"])
def network(request: pytest.FixtureRequest) -> Iterator[Open]:
    """Opens participants: the first is the hub."""
    opened: list[Bus] = []
    memory = MemoryNetwork()
    endpoint = free_endpoint()

    def open_one() -> Bus:
        if request.param == "memory":
            opened.append(memory.endpoint())
        else:
            opened.append(ZenohBus.client(endpoint) if opened else ZenohBus.router(endpoint))
        return opened[-1]

    yield open_one
    for bus in reversed(opened):
        bus.close()


@pytest.fixture(params=BACKENDS)
def backend(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Backend:
    """Every form of the reader and the writer of a tick's messages, one after the other."""
    chosen = BACKENDS[request.param]
    monkeypatch.setattr(kernels, "read", chosen.read)
    monkeypatch.setattr(kernels, "write", chosen.write)
    return chosen
