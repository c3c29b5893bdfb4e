"""Store of a study's finished jobs, a file each, so that an interrupted study flies only the rest.

In DIR, the folder of `--out`:
    DIR/data/jobs/*.job    with checksums, written atomically
    DIR/data/*.parquet     tables made from them, if any
"""

import hashlib
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from meanflock.studies.job_file import StoredRun, decode, version
from meanflock.swarm import durable
from meanflock.swarm.errors import BadInput, RunFailed

DATA = "data"


class Store:
    """The job files of one output folder, and the tables made of them."""

    def __init__(self, out: Path, code: str | None = None) -> None:
        """Args:
            code: version of the code on which the runs depend; None: that of the package.

        Raises:
            BadInput: the folder cannot be made.
        """
        self._code = code or version()
        self.data = out / DATA
        self._jobs = self.data / "jobs"
        try:
            self._jobs.mkdir(parents=True, exist_ok=True)
            for left_over in self._jobs.glob(".*.part"):
                left_over.unlink()
        except OSError as error:
            raise BadInput(f"--out {out}: {error.strerror}; name a folder that can be written") from error

    def finished(self) -> dict[str, StoredRun]:
        """All valid runs, by key. Invalid files are deleted, and flown again."""
        runs: dict[str, StoredRun] = {}
        for path in sorted(self._jobs.glob("*.job")):
            try:
                runs.update((run.key, run) for run in decode(path.read_bytes(), self._code))
            except ValueError:
                path.unlink(missing_ok=True)
        return runs

    def add(self, raw: bytes) -> None:
        """Store the encoded runs of a job.

        Raises:
            RunFailed: the disk is full or the folder gone, or the worker runs other code than this process; what was
                finished before is kept.
        """
        try:
            decode(raw, self._code)
        except ValueError as error:
            raise RunFailed(
                f"a worker's result is {error}, this is {self._code}: give workers the same code"
            ) from error
        self.write(self._jobs / f"{hashlib.sha256(raw).hexdigest()[:24]}.job", raw)

    def write(self, path: Path, raw: bytes | memoryview) -> None:
        """Write a file atomically; raises RunFailed."""
        durable.put(path, raw, "the runs finished so far are kept: make room and repeat the command")

    def save(self, name: str, table: pa.Table) -> None:
        """Writes one of the tables."""
        sink = pa.BufferOutputStream()
        pq.write_table(table, sink, compression="zstd")
        self.write(self.data / f"{name}.parquet", memoryview(sink.getvalue()))
