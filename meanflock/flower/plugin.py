"""Plug-in of a Flower app: a file with its learner and its aggregation rule, which every process of a flight loads."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from meanflock.flower.app import App
from meanflock.swarm.durable import writable
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
    """Write the plug-in of an app into a folder; its learner and its rule have the name of the app."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{app.name}.py"
    path.write_text(_SOURCE.format(fingerprint=app.fingerprint, **app._asdict()), encoding="utf-8")
    return path


@contextmanager
def written(app: App, folder: Path) -> Iterator[Path]:
    """Context with the plug-in of an app in a folder of `--out`; if the app is refused, what is new is deleted again.

    Raises:
        BadInput: the folder cannot be written.
    """
    new = [path for path in (folder / f"{app.name}.py", folder, folder.parent) if not path.exists()]
    with writable("--out", folder.parent):
        path = write(app, folder)
    try:
        yield path
    except BadInput:
        for made in new:
            with suppress(OSError):  # another flight has begun in it
                made.unlink() if made == path else made.rmdir()
        raise
