"""Plug-in of a Flower app: a file with its learner and its aggregation rule, which every process of a flight loads."""

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from meanflock.flower.app import App
from meanflock.swarm.durable import replace, writable
from meanflock.swarm.errors import BadInput

_SOURCE = '''"""The Flower app {folder}, whose files have the hash {fingerprint}."""

from meanflock.flower.app import App
from meanflock.flower.client import FlowerClient
from meanflock.flower.server import FlowerServer


class Client(FlowerClient):
    name = {name!r}
    app = App({folder!r}, {client!r}, {server!r}, {name!r}, {config!r})


class Server(FlowerServer):
    name = {name!r}
    client = Client


_ = Client.app.client_app  # imported before processes are forked, which share it
'''


def write(app: App, folder: Path) -> Path:
    """Write the plug-in of an app into a folder; its learner and its rule have the name of the app.

    The file is named by its content, too: flights of an app with other configurations may share the folder.
    """
    source = _SOURCE.format(fingerprint=app.fingerprint, **app._asdict()).encode()
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{app.name}-{hashlib.sha256(source).hexdigest()[:8]}.py"
    replace(path, source)
    return path


@contextmanager
def written(app: App, folder: Path) -> Iterator[Path]:
    """Context with the plug-in of an app in a folder of `--out`; if the app is refused, what is new is deleted again.

    Raises:
        BadInput: the folder cannot be written.
    """
    old = {*folder.glob("*.py"), *(each for each in (folder, folder.parent) if each.exists())}
    with writable("--out", folder.parent):
        path = write(app, folder)
    try:
        yield path
    except BadInput:
        for made in (path, folder, folder.parent):
            if made not in old:
                with suppress(OSError):  # another flight has begun in it
                    made.unlink() if made == path else made.rmdir()
        raise
