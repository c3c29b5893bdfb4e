"""Links of a router, some of which end: the others go on."""

import subprocess
import sys
import threading
from collections.abc import Iterator

import pytest

from meanflock.groundstation.launch.processes import free_endpoint
from meanflock.swarm.net.session import ZenohBus
from tests.polling import until

DYING = 20
CLIENTS = """
import sys
from meanflock.swarm.net.session import ZenohBus

endpoint, name, count = sys.argv[1:]
sessions = [ZenohBus.client(endpoint, 30.0) for _ in range(int(count))]
for number, bus in enumerate(sessions):
    bus.subscribe(f"links/to/{name}/{number}")
    bus.watch("links/alive/*/*")
    bus.announce(f"links/alive/{name}/{number}")
while True:
    for bus in sessions:
        bus.receive(0.01)
"""


class Router:
    """A router, and its clients in processes of their own."""

    def __init__(self) -> None:
        self._endpoint = free_endpoint()
        self.bus = ZenohBus.router(self._endpoint)
        self.bus.watch("links/alive/*/*")
        self.alive: dict[str, bool] = {}  # by key of a token
        self.processes: list[subprocess.Popen[bytes]] = []

    def start(self, name: str, count: int) -> "subprocess.Popen[bytes]":
        """A process with so many sessions."""
        process = subprocess.Popen([sys.executable, "-c", CLIENTS, self._endpoint, name, str(count)])
        self.processes.append(process)
        self.wait_for(name, count)
        return process

    def wait_for(self, name: str, count: int) -> None:
        """Waits until so many sessions of a name are alive."""

        def present() -> bool:
            while (delivery := self.bus.receive(0.01)) is not None:
                self.alive[delivery.key] = delivery.kind == "alive"
            return sum(alive for key, alive in self.alive.items() if name in key) == count

        until(present, f"{count} sessions of {name}", pause_s=0.0)


@pytest.fixture
def router() -> Iterator[Router]:
    one = Router()
    yield one
    for process in one.processes:
        process.kill()
        process.wait()
    one.bus.close()


@pytest.mark.processes
def test_clients_that_die_while_much_is_sent_cost_no_other_client_its_link(router: Router) -> None:
    """The thread that reports the end of a link must not be the one that sends: else the router waits for itself for
    as long as a lease, and closes links that are well."""
    router.start("listener", 1)
    over = threading.Event()

    def send(name: str, count: int, payload: bytes) -> None:
        while not over.wait(0.0005):
            for number in range(count):
                router.bus.put(f"links/to/{name}/{number}", payload)

    loads = (("listener", 1, bytes(300_000)), ("dying", DYING, bytes(200)))
    sending = [threading.Thread(target=send, args=load) for load in loads]
    for thread in sending:
        thread.start()
    try:
        for _ in range(2):
            router.start("dying", DYING).kill()
            router.wait_for("dying", 0)
    finally:
        over.set()
        for thread in sending:
            thread.join()
    assert router.alive["links/alive/listener/0"]
