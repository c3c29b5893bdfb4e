"""Links of a router, some of which end: the others go on."""

import subprocess
import sys
import threading

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


@pytest.mark.processes
def test_clients_that_die_while_much_is_sent_cost_no_other_client_its_link() -> None:
    """The thread that reports the end of a link must not be the one that sends: else the router waits for itself for
    as long as a lease, and closes links that are well."""
    endpoint = free_endpoint()
    router, over = ZenohBus.router(endpoint), threading.Event()
    router.watch("links/alive/*/*")
    alive: dict[str, bool] = {}  # by key of a token
    clients: list[subprocess.Popen[bytes]] = []

    def wait_for(name: str, count: int) -> None:
        def present() -> bool:
            while (delivery := router.receive(0.01)) is not None:
                alive[delivery.key] = delivery.kind == "alive"
            return sum(is_alive for key, is_alive in alive.items() if name in key) == count

        until(present, f"{count} sessions of {name}", pause_s=0.0)

    def start(name: str, count: int) -> None:
        clients.append(subprocess.Popen([sys.executable, "-c", CLIENTS, endpoint, name, str(count)]))
        wait_for(name, count)

    def send(name: str, count: int, payload: bytes) -> None:
        while not over.wait(0.0005):
            for number in range(count):
                router.put(f"links/to/{name}/{number}", payload)

    loads = (("listener", 1, bytes(300_000)), ("dying", DYING, bytes(200)))
    sending = [threading.Thread(target=send, args=load) for load in loads]
    try:
        start("listener", 1)
        for thread in sending:
            thread.start()
        for _ in range(2):
            start("dying", DYING)
            clients[-1].kill()
            wait_for("dying", 0)
        assert alive["links/alive/listener/0"]
    finally:
        over.set()
        for thread in sending:
            thread.join()
        for client in clients:
            client.kill()
            client.wait()
        router.close()
