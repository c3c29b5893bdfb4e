"""A node gone bad, in a process of its own: opens sessions with its certificate and puts far too much under its key.

`python -m tests.security.flood ENDPOINT FOLDER NAME KEY SESSIONS MEGABYTES` says "begun" for each session.
"""

import sys
import threading
from pathlib import Path

from meanflock.swarm.net.access import Identity
from meanflock.swarm.net.session import ZenohBus
from tests.polling import DEADLINE_S


def _flood(endpoint: str, folder: Path, name: str, key: str, payload: bytes) -> None:
    bus = ZenohBus.client(endpoint, DEADLINE_S, Identity(folder, name))
    print("begun", flush=True)
    while True:
        bus.put(key, payload)


if __name__ == "__main__":
    endpoint, folder, name, key, sessions, megabytes = sys.argv[1:]
    payload = bytes(int(megabytes) * 10**6)
    for _ in range(int(sessions)):
        threading.Thread(target=_flood, args=(endpoint, Path(folder), name, key, payload)).start()
