"""A Flower app in a folder, and the records that its messages have."""

import hashlib
import importlib
import logging
import os
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

from meanflock.swarm.errors import FAILURES, BadInput, last_line
from meanflock.swarm.global_generators import Generators
from meanflock.swarm.plugins.loader import read
from meanflock.swarm.toml import parse

os.environ["FLWR_TELEMETRY_ENABLED"] = "0"  # Flower reads it when it is imported

import numpy as np
from flwr.app import Array, ArrayRecord, Context, RecordDict
from flwr.clientapp import ClientApp
from flwr.common.serde import recorddict_from_proto, recorddict_to_proto
from flwr.proto.recorddict_pb2 import RecordDict as Proto
from flwr.serverapp import ServerApp
from flwr.supercore.task_identity import TaskIdentity
from numpy.typing import NDArray

_IMPORT_SEED = 0  # of the global generators while an app is imported
FIRST_NODE = 1000  # number of the node on UAV 0
SUFFIXES = (".py", ".toml")  # of files whose change makes another app

logging.getLogger("flwr").setLevel(logging.ERROR)
TaskIdentity.task_id = TaskIdentity.run_id = TaskIdentity.node_id = 1


class App(NamedTuple):
    """A Flower app: its folder, `module:attribute` of its two halves, its name, and its own configuration."""

    folder: str
    client: str
    server: str
    name: str
    config: dict[str, Any]

    @classmethod
    def read(cls, folder: Path) -> "App":
        """The app that the file pyproject.toml of a folder describes.

        Raises:
            BadInput: there is no such file, or it describes no app.
        """
        path = folder / "pyproject.toml"
        try:
            project = parse(read(path))
            table = project["tool"]["flwr"]["app"]
            client, server = (table["components"][key] for key in ("clientapp", "serverapp"))
        except OSError as error:
            raise BadInput(f"{path}: {error.strerror}; name the folder of a Flower app") from error
        except ValueError as error:
            raise BadInput(f"{path}: not TOML: {error}") from error
        except (KeyError, TypeError) as error:
            raise BadInput(
                f"{path}: describes no Flower app; `clientapp` and `serverapp` stand in [tool.flwr.app.components]"
            ) from error
        for key, component in (("clientapp", client), ("serverapp", server)):
            if not (isinstance(component, str) and all(component.partition(":"))):
                raise BadInput(
                    f"{path}: `{key}` is {component!r}; expected a module and a name in it, as app.client:app"
                )
        name = "".join(
            sign if sign.isalnum() else "-" for sign in str(project.get("project", {}).get("name", folder.name))
        )
        return cls(str(folder.resolve()), client, server, f"flower-{name}", dict(_flat(table.get("config", {}))))

    @property
    def rounds(self) -> int:
        """`num-server-rounds` of its configuration; 0 if it has none."""
        rounds = self.config.get("num-server-rounds")
        return rounds if isinstance(rounds, int) else 0

    @property
    def fingerprint(self) -> str:
        """Hash of the files of the app."""
        digest = hashlib.sha256()
        for path in sorted(Path(self.folder).rglob("*")):
            if path.is_file() and path.suffix in SUFFIXES and "." not in path.parent.name:
                digest.update(path.relative_to(self.folder).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
        return digest.hexdigest()

    @property
    def client_app(self) -> ClientApp:
        """Its ClientApp, imported from its folder."""
        return self._component("clientapp", self.client, ClientApp)

    @property
    def server_app(self) -> ServerApp:
        """Its ServerApp, imported from its folder."""
        return self._component("serverapp", self.server, ServerApp)

    def _component(self, key: str, component: str, kind: type[Any]) -> Any:
        place = f"Flower app {self.folder}: `{key}` {component}"
        module, _, attribute = component.partition(":")
        if self.folder not in sys.path:
            sys.path.insert(0, self.folder)
        try:
            with Generators(_IMPORT_SEED):  # modules may draw when they are imported
                found = getattr(importlib.import_module(module), attribute)
        except FAILURES as error:
            raise BadInput(f"{place}: {last_line(error)}; {_remedy(error)}") from error
        if not isinstance(found, kind):
            raise BadInput(f"{place}: is a {type(found).__name__}; expected a {kind.__name__}")
        return found

    def at_fault(self, error: BaseException) -> BaseException:
        """The error with a traceback that begins in the files of the app, so that messages name their lines."""
        place = error.__traceback__
        while place is not None and not place.tb_frame.f_code.co_filename.startswith(self.folder + os.sep):
            place = place.tb_next
        return error.with_traceback(place or error.__traceback__)


def _remedy(error: BaseException) -> str:
    """What mends an app that cannot be imported."""
    if isinstance(error, ImportError) and (error.name or "").partition(".")[0] == "flwr":
        return f"Flower {version('flwr')} has no such name, so the app is for another version: port it to this one"
    return "install what the app needs, or correct its pyproject.toml"


def context(node: int, run_config: dict[str, Any], uav: int | None = None, uavs: int = 0) -> Context:
    """The context of one half of an app: of the ServerApp, or of the ClientApp on a UAV."""
    config: dict[str, Any] = {} if uav is None else {"partition-id": uav, "num-partitions": uavs}
    return Context(1, node, config, RecordDict(), dict(run_config))


def split(content: RecordDict) -> tuple[dict[str, NDArray[Any]], bytes]:
    """The arrays of a message, and all else in it as bytes.

    Raises:
        ValueError: it has not one record of arrays.
    """
    records = list(content.array_records.items())
    if len(records) != 1:
        raise ValueError(
            f"a message of a training has {len(records)} ArrayRecords; a round carries one model, so neither secure "
            "aggregation, which exchanges keys, nor a model in a ConfigRecord can fly"
        )
    name, record = records[0]
    rest = RecordDict({key: value for key, value in content.items() if key != name})
    arrays = {key: array.numpy() for key, array in record.items()}
    return arrays, bytes([len(name)]) + name.encode() + bytes_of(rest)


def joined(arrays: dict[str, NDArray[Any]], note: bytes) -> RecordDict:
    """The content of a message of its arrays and the bytes of all else."""
    name, rest = note[1 : 1 + note[0]].decode(), records_of(note[1 + note[0] :])
    record = ArrayRecord({key: Array(np.asarray(array, order="C")) for key, array in arrays.items()})
    return RecordDict({name: record, **rest})


def cast(arrays: dict[str, NDArray[Any]], first: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Arrays in the dtypes of those that were sent first: apps compute in wider floats, and make floats of whole
    numbers."""
    return {
        name: (np.rint(array) if first[name].dtype.kind in "iu" else array).astype(first[name].dtype)
        if name in first
        else array
        for name, array in arrays.items()
    }


def bytes_of(content: RecordDict) -> bytes:
    """Records as bytes."""
    return recorddict_to_proto(content).SerializeToString(deterministic=True)


def records_of(raw: bytes) -> RecordDict:
    """The records in bytes; none in no bytes."""
    return recorddict_from_proto(Proto.FromString(raw))


def numbers_in(content: RecordDict) -> dict[str, float]:
    """The single numbers among the metrics of a message, by name."""
    found: dict[str, float] = {}
    for record in content.metric_records.values():
        found |= {name: float(value) for name, value in record.items() if isinstance(value, int | float)}
    return found


def _flat(table: dict[str, Any], path: str = "") -> list[tuple[str, Any]]:
    """Keys and values of nested tables; the parts of a key are joined by dots, as Flower does."""
    pairs: list[tuple[str, Any]] = []
    for name, value in table.items():
        pairs += _flat(value, f"{path}{name}.") if isinstance(value, dict) else [(path + name, value)]
    return pairs
