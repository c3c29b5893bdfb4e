"""`python -m tests.faults.clients ENDPOINT NAME COUNT`: clients in a process of their own, with tokens, that listen."""

import sys

from meanflock.swarm.net.session import ZenohBus


def main(endpoint: str, name: str, count: str) -> None:
    """Until it is killed."""
    sessions = [ZenohBus.client(endpoint, 30.0) for _ in range(int(count))]
    for number, bus in enumerate(sessions):
        bus.subscribe(f"links/to/{name}/{number}")
        bus.watch("links/alive/*/*")
        bus.announce(f"links/alive/{name}/{number}")
    while True:
        for bus in sessions:
            bus.receive(0.01)


if __name__ == "__main__":
    main(*sys.argv[1:])
