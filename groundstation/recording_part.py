"""A part of a recording: where several flights share one, the entities of each lie under a name of its own."""

from typing import Protocol

import rerun as rr


class Logs(Protocol):
    """A recording, or a part of one."""

    def log(self, entity_path: str, entity: rr.AsComponents, *extra: rr.AsComponents, static: bool = False) -> None:
        """Logs components of an entity."""


class Part:
    """Logs under a prefix, which ends in `/`; the whole recording where it is empty."""

    def __init__(self, stream: rr.RecordingStream, prefix: str) -> None:
        self._stream, self._prefix = stream, prefix

    def log(self, entity_path: str, entity: rr.AsComponents, *extra: rr.AsComponents, static: bool = False) -> None:
        """As a recording does."""
        self._stream.log(self._prefix + entity_path, entity, *extra, static=static)
