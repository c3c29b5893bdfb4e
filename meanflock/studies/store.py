"""Store of a study's finished jobs, a file each, so that an interrupted study flies only the rest.

In DIR, the folder of `--out`:
    DIR/data/jobs/*.job    with checksums, written atomically
    DIR/data/*.parquet     tables made from them, if any
    DIR/code.txt           version of the code, if the study mixes no codes
"""

import hashlib
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from meanflock.studies.job_file import StoredRun, decode, version
from meanflock.swarm import durable, paths
from meanflock.swarm.errors import BadInput, RunFailed

DATA = "data"
_FORGOTTEN_S = 3600.0  # before the last change of the folder: a file that no process writes any more
CODE = "code.txt"  # version of the code that flew the runs of a folder


class Store:
    """The job files of one output folder, and the tables made of them."""

    def __init__(self, out: Path, code: str | None = None) -> None:
        """Args:
            code: version of the code on which the runs depend; None: that of the package.

        Raises:
            BadInput: the folder cannot be made.
        """
        self._code = code or version()
        self._runs: dict[str, StoredRun] | None = None  # those that were read or added
        self._out = out
        self.data = out / DATA
        self._jobs = self.data / "jobs"
        with durable.writable("--out", out):
            self._jobs.mkdir(parents=True, exist_ok=True)
            for left_over in self._jobs.glob(".*.part"):
                if left_over.stat().st_mtime < self._jobs.stat().st_mtime - _FORGOTTEN_S:  # else a study may write it
                    left_over.unlink(missing_ok=True)

    def finished(self) -> dict[str, StoredRun]:
        """All valid runs, by key. Invalid files are deleted, and flown again. Files are read once."""
        if self._runs is None:
            self._runs = {}
            for path in sorted(self._jobs.glob("*.job")):
                try:
                    raw = paths.read(path, paths.LOG_BYTES)
                    self._runs.update((run.key, run) for run in decode(raw, self._code))
                except (OSError, ValueError):
                    path.unlink(missing_ok=True)
        return dict(self._runs)

    def claim(self) -> None:
        """Mark the folder with the version of the code that flies.

        Raises:
            BadInput: the folder has flights of other code, which must not be mixed with these.
        """
        mark = self._out / CODE
        if mark.exists() and (other := paths.read(mark).decode(errors="replace").strip()) != self._code:
            raise BadInput(
                f"{self._out}: its flights are of code {other}, this is {self._code}; name another folder: --out DIR"
            )
        durable.replace(mark, f"{self._code}\n".encode())

    def add(self, raw: bytes) -> None:
        """Store the encoded runs of a job.

        Raises:
            RunFailed: the disk is full or the folder gone, or the worker runs other code than this process; what was
                finished before is kept.
        """
        try:
            runs = decode(raw, self._code)
        except ValueError as error:
            raise RunFailed(
                f"a worker's result is {error}, this is {self._code}: give workers the same code"
            ) from error
        self.write(self._jobs / f"{hashlib.sha256(raw).hexdigest()[:24]}.job", raw)
        if self._runs is not None:
            self._runs.update((run.key, run) for run in runs)

    def write(self, path: Path, raw: bytes | memoryview) -> None:
        """Write a file atomically; raises RunFailed."""
        durable.put(path, raw, "the runs finished so far are kept: ")

    def save(self, name: str, table: pa.Table) -> None:
        """Writes one of the tables."""
        sink = pa.BufferOutputStream()
        pq.write_table(table, sink, compression="zstd")
        self.write(self.data / f"{name}.parquet", memoryview(sink.getvalue()))
