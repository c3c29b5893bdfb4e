"""A part of a recording: where several flights share one, the entities of each lie under a name of its own."""

import rerun as rr


class Part:
    """Logs what does not move under a prefix, which ends in `/`; in the whole recording where it is empty."""

    def __init__(self, stream: rr.RecordingStream, prefix: str) -> None:
        self._stream, self._prefix = stream, prefix

    def log(self, entity: str, what: rr.AsComponents) -> None:
        """Logs components of an entity, for all times."""
        self._stream.log(self._prefix + entity, what, static=True)
