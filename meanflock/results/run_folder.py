"""The run folder: all files of a run, complete at its end and usable after a kill."""

import errno
import hashlib
import json
import os
import shlex
import shutil
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow as pa

from meanflock.federation.plan import plan_of
from meanflock.results import flown_file, flown_plugins, inbound
from meanflock.results.event_log import EventLog, lock, past_events, stored_lines
from meanflock.results.rounds_table import write_rounds
from meanflock.results.scenario_name import headed
from meanflock.results.series import block_of, check_reports, unbroken
from meanflock.results.spool import Spool, spooled
from meanflock.results.timeseries_file import SPOOL, TIMESERIES, Past, read_table, recover
from meanflock.swarm import durable, paths, scenario
from meanflock.swarm.durable import reason, remedy
from meanflock.swarm.errors import BadInput, MessageRejected, RunFailed
from meanflock.swarm.events import AgentFailed, AverageFailed, Diverged, FitFailed, FlightFinished, LeaderFailed, Lost
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire import control
from meanflock.swarm.wire.messages import Telemetry
from meanflock.worldsim.checkpoint import Assembly

SCENARIO = "scenario.toml"
SUMMARY = "summary.json"
EVENTS = "events.jsonl"
RECORDING = "recording.rrd"
CHECKPOINT = "checkpoint.msgpack"  # only while the run is not finished
LOSS = (AgentFailed, Diverged, Lost)  # events that say why UAVs are lost
NO_AVERAGE = (LeaderFailed, AverageFailed)  # those that say why a round has no average
_PAST_STATES = 50_000  # of rows that are spooled once more, in one block


class BackgroundWorker:
    """Single-slot executor for work that waits for a disk; `do` blocks while it is busy.

    Not for work that computes in many small steps: each step hands Python's lock over, which costs the flight more.
    """

    def __init__(self, name: str) -> None:
        """`name`: of the thread."""
        self._pool = ThreadPoolExecutor(1, thread_name_prefix=name)
        self._doing: Future[None] | None = None

    def do(self, work: Callable[..., None], *arguments: Any) -> None:
        """Wait for the last work, then begin the next. Raises the error of the last work, and then begins nothing."""
        self.wait()
        self._doing = self._pool.submit(work, *arguments)

    def look(self) -> None:
        """Raise the error of the work, if it has failed."""
        if self._doing is not None and self._doing.done():
            self.wait()

    def wait(self) -> None:
        """Wait for the work. Raises its error, once."""
        doing, self._doing = self._doing, None
        if doing is not None:
            doing.result()

    def close(self) -> None:
        """Wait, and accept no more work."""
        try:
            self.wait()
        finally:
            self._pool.shutdown()


class RunFolder:
    """Writes one run; a `Sink`."""

    def __init__(
        self, parent: Path, run_id: str, flown: Scenario, past: Past | None = None, mission: str | None = None
    ) -> None:
        """Writes the scenario into `parent/run_id`, which is new or empty; with a `past`, goes on in that folder.

        `mission`: name of the scenario, for a new run; None: it has none.

        Raises:
            BadInput: the folder cannot be created or written, another process still writes it, events or rows of the
                past are missing or damaged, the file of a plug-in is not what was loaded, or a diagnostic is called
                like another column. A folder with a past is then as it was.
        """
        self.path = parent / run_id
        advice = f"bring the file back, or {fly_again(self.path)}"
        if past is not None:
            past_events(self.path / EVENTS, past.events_bytes, flown.uavs, advice)
        flown = plan_of(flown).given
        check_reports(plan_of(flown))
        self._flown, self._resumed = flown, past is not None
        self._over = False
        self._full: OSError | None = None  # why nothing more can be written
        self.last_tick = -1
        self._new = False  # whether this object may delete the folder
        self._owner = os.getpid()
        self._has_rounds = plan_of(flown).declared.is_federated
        self.files = [SCENARIO, EVENTS, TIMESERIES]  # that must be there at the end
        sources = flown_plugins.files(flown) if past is None else {}
        read = flown_file.contents(flown) if past is None else {}
        try:
            if past is None:
                self._create(sources, read, mission)
            self._events = EventLog(self.path / EVENTS, flown.dt)
        except OSError as error:
            raise self._unusable(error) from error
        try:
            self._spool = self._begin(past)
        except OSError as error:
            self._events.close()
            raise self._unusable(error) from error
        except MessageRejected as error:
            self._events.close()
            raise BadInput(f"{self.path}: rows of the time series are damaged ({error}); {advice}") from error
        self._assembly = Assembly()
        self._checkpointed: dict[str, Any] = {}  # where the checkpoint that is being joined begins
        self._background = BackgroundWorker("checkpoints")  # they wait for the disk

    def _create(self, sources: dict[str, bytes], read: dict[str, bytes], mission: str | None) -> None:
        """Create the folder of a new run, with the scenario, the files of its plug-ins and those of its vehicles."""
        self.path.mkdir(parents=True, exist_ok=True)
        if any(self.path.iterdir()):
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST))
        self._new = True
        durable.replace(self.path / SCENARIO, headed(to_toml(self._flown), mission).encode())
        flown_plugins.keep(self.path, sources)
        self.files += [f"{flown_plugins.FOLDER}/{name}" for name in sources]
        flown_file.keep(self.path, read)
        self.files += read
        durable.sync_folder(self.path.parent)

    def _begin(self, past: Past | None) -> Spool:
        """Begin a new spool, with all rows of a resumed run, and delete the events about its end.

        Raises:
            MessageRejected: a row of the past is damaged. OSError: there is no room. The folder is as it was.
        """
        for left_over in self.path.glob(".*.part"):  # of a process that was killed
            left_over.unlink()
        spool = self.path / SPOOL
        part = spool.with_suffix(".part")
        try:
            begun = Spool(part, self._flown.dt)
            if past is not None:
                for rows in unbroken(past.rows, max(1, _PAST_STATES // self._flown.uavs)):
                    block = inbound.check(
                        block_of(rows, past.next_block - 1), self._flown.uavs, dimensions=self._flown.dimensions
                    )
                    begun.append(block, past.events_bytes)
                self.last_tick = past.rows.num_rows - 1
                self._events.truncate(past.events_bytes)
                _sync(self._events, begun)
                (self.path / SUMMARY).unlink(missing_ok=True)
            durable.rename(part, spool)
        except (OSError, MessageRejected):
            part.unlink(missing_ok=True)
            raise
        return begun

    def _unusable(self, error: OSError) -> BadInput:
        if self._new:
            shutil.rmtree(self.path, ignore_errors=True)
        if self._resumed:
            return BadInput(f"{self.path}: {reason(error)}; {remedy(error)}, then give the command again")
        return BadInput(f"--out {self.path.parent}: {reason(error)}; name a folder that can be written")

    def write(self, block: Telemetry) -> None:
        """Append a block and its events. Events come first, so that a complete block has all of them.

        Raises:
            RunFailed: the disk is full or gone, and the folder has all blocks before this one; or this process is a
                fork of the one that began the run.
        """
        self.check_owner()
        if self._full is not None:
            raise self._failed(self._full)
        size = self._events.size
        try:
            self._background.look()  # without room for a checkpoint there is none for more blocks
            self._append(block)
        except OSError as error:
            self._full = error
            with suppress(OSError):
                self._events.truncate(size)
            raise self._failed(error) from error
        self.last_tick = block.first_tick + len(block.states) - 1
        self._over |= any(isinstance(event, FlightFinished) for event in block.events)

    def _append(self, block: Telemetry) -> None:
        self._events.append(block.events)
        events_bytes = self._events.size
        self._spool.append(block, events_bytes)
        if block.checkpoint:
            body = self._assembly.add(block.checkpoint)
            if self._assembly.begun:
                tick = block.first_tick + len(block.states) - 1
                self._checkpointed = {"tick": tick, "block": block.block, "events_bytes": events_bytes}
            if body is not None:
                self._background.do(self._keep, self._checkpointed, body)

    def _keep(self, begun: dict[str, Any], body: bytes) -> None:
        _sync(self._events, self._spool)  # a checkpoint goes on from these rows and events
        record = control.parts_of_record(begun, "body", [body])  # hundreds of megabytes, if UAVs learn large models
        whole = control.parts_of_record({"sha256": _digest(*record)}, "record", record)
        durable.replace(self.path / CHECKPOINT, *whole)

    def check_owner(self) -> None:
        """Raise RunFailed in a fork of the process that began the run, to which the folder belongs."""
        if not self.is_owner:
            raise RunFailed(
                f"{self.path}: the process that began this run writes it; a fork of it cannot fly it on: begin another "
                "flight in the fork"
            )

    @property
    def is_owner(self) -> bool:
        """This process began the run, and is no fork of the process that did."""
        return os.getpid() == self._owner

    def _failed(self, error: OSError) -> RunFailed:
        if not self.path.is_dir():
            return RunFailed(f"{self.path}: deleted or renamed during the flight; give the command again")
        contents = f"the flight up to tick {self.last_tick}" if self.last_tick >= 0 else "nothing of the flight yet"
        return RunFailed(f"{self.path}: {reason(error)}; it holds {contents}: {remedy(error)}, then {self._go_on()}")

    def _go_on(self) -> str:
        has_sources = flown_plugins.sources(self._flown) is not None  # else no command knows what flies
        return go_on(self.path) if has_sources else "begin another flight"

    def summarise(self, summary: dict[str, Any]) -> None:
        """Write `summary.json` atomically; delete the checkpoint if the flight is over. A failed run has no summary.

        Raises:
            RunFailed: there is no room for it.
        """
        self.check_owner()
        try:
            self._background.wait()
            _sync(self._events, self._spool)
            durable.replace(self.path / SUMMARY, (json.dumps(summary, indent=1) + "\n").encode())
        except OSError as error:
            raise self._failed(error) from error
        self.files.append(SUMMARY)
        if self._over:
            durable.remove(self.path / CHECKPOINT)

    def __enter__(self) -> "RunFolder":
        return self

    def __exit__(self, failure: type[BaseException] | None, *_: object) -> None:
        """Complete the time series; delete the folder after bad input, when nothing was flown.

        Raises:
            RunFailed: there is no room for the time series, and the spool keeps its rows; or a file of the run was
                deleted during the flight.
        """
        open_files = ((self._events, EVENTS), (self._spool, SPOOL))
        gone = [name for file, name in open_files if not _is_at(file, self.path / name)]
        try:
            try:
                self._background.close()
            except OSError as error:
                self._full = error  # no room for a checkpoint, none for the time series
                raise
            finally:
                self._spool.close()
            if failure is not None and issubclass(failure, BadInput) and not self._resumed:
                shutil.rmtree(self.path)
            elif self._full is None:  # without room the rows stay in the spool, as after a kill
                if EVENTS not in gone and self._has_rounds:
                    write_rounds(self.path, self.path / EVENTS, self._flown.dt)
                if SPOOL not in gone:
                    recover(self.path)  # last: as long as there is a spool, the folder is not complete
                gone += [name for name in self.files if not (self.path / name).exists() and name not in gone]
                if gone and failure is None:
                    raise RunFailed(
                        f"{self.path}: deleted or renamed during the flight: {', '.join(gone)}; bring back what can be "
                        f"brought back, or {fly_again(self.path)}"
                    )
        except OSError as error:
            if failure is None:
                raise RunFailed(
                    f"{self.path}: {reason(error)}; {remedy(error)}, then `meanflock plot {self.path}`"
                ) from error
        finally:
            self._events.close()


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Context in which no other process writes to the run in `folder`.

    Raises:
        BadInput: another process writes to it, or its events cannot be read.
    """
    with ExitStack() as stack:
        try:
            lock(stack.enter_context(paths.opened(folder / EVENTS)), folder)
        except FileNotFoundError:
            pass  # nobody writes it
        except OSError as error:
            raise BadInput(f"{folder / EVENTS}: {reason(error)}; let it be read, or bring the file back") from error
        yield


def go_on(folder: Path) -> str:
    """Text that says how to fly the rest of a run that did not finish, with its plug-ins if they are here."""
    if (folder / CHECKPOINT).exists():
        return f"`{shlex.join(['meanflock', 'resume', str(folder), *(_plugin_options(folder) or ())])}` flies the rest"
    return f"there is no checkpoint to resume from: {fly_again(folder)}"


def fly_again(folder: Path) -> str:
    """Text that says how to fly a run again, with the command if its scenario and plug-ins are here."""
    options = _plugin_options(folder)
    if options is None:
        return "fly the run again"
    return f"fly the run again with `{shlex.join(['meanflock', 'run', str(folder / SCENARIO), *options])}`"


def _plugin_options(folder: Path) -> list[str] | None:
    """The options `--plugin` of a run; None if its scenario or a plug-in is not here."""
    path = folder / SCENARIO
    try:
        files = flown_plugins.sources(scenario.load(path)) if path.is_file() else None
    except BadInput:
        return None
    return None if files is None else [text for file in files for text in ("--plugin", file)]


def _sync(events: EventLog, spool: Spool) -> None:
    """Wait until all rows and events so far are on the disk."""
    for file in (events, spool):
        os.fsync(file.fileno())


class Failures(NamedTuple):
    """Texts of the events of a flight, in order of time, about what failed.

    losses: why UAVs are lost. rules: of the aggregation rule. trainings: those that gave no model.
    """

    losses: list[str]
    rules: list[str]
    trainings: list[str]

    @classmethod
    def of_run(cls, folder: Path) -> "Failures":
        """Reads the events of a run once."""
        found = cls([], [], [])
        texts = dict(zip((LOSS, NO_AVERAGE, (FitFailed,)), found, strict=True))
        by_tag = {kind.__struct_config__.tag: told for kinds, told in texts.items() for kind in kinds}
        for row in map(json.loads, stored_lines(folder / EVENTS)):
            if (told := by_tag.get(row["event"])) is not None:
                told.append(str(row["text"]))
        return found


def lost_everyone(folder: Path) -> str:
    """Error text of a finished run that lost every UAV, with the reason of the first loss."""
    loss = next(iter(Failures.of_run(folder).losses), "")
    return f"every UAV was lost: {loss}; all events are in {folder / EVENTS}, the summary in {SUMMARY}"


def completed(folder: Path) -> None:
    """Complete the rounds and the time series of a run that was killed, also after its summary was written.

    Raises:
        BadInput: its events are damaged.
        RunFailed: there is no room for the tables; the spool keeps its rows.
    """
    if not (folder / SPOOL).exists():
        return
    try:
        if (folder / EVENTS).exists():
            dt = next((stored.dt for stored in spooled(folder / SPOOL)), 0.0)  # without rows there are no rounds
            write_rounds(folder, folder / EVENTS, dt)
        recover(folder)
    except OSError as error:
        raise RunFailed(f"{folder}: {reason(error)}; {remedy(error)}, then give the command again") from error


def flown_rows(folder: Path, columns: list[str] | None = None) -> pa.Table:
    """The time series of the run in `folder`, or some of its columns.

    Raises:
        BadInput: no run there, a damaged file, or a run that never took off.
    """
    path = folder / TIMESERIES
    try:
        table = read_table(path, columns)
    except OSError as error:
        raise unreadable(path, error) from error
    check_flown(path, table.num_rows)
    return table


def unreadable(path: Path, error: OSError) -> BadInput:
    """The error of a time series that cannot be read, with advice."""
    is_run = (path.parent / SCENARIO).is_file()
    advice = f"bring the file back, or {fly_again(path.parent)}" if is_run else "name the folder of a run"
    return BadInput(f"{path}: {error.strerror or error}; {advice}")


def check_flown(path: Path, ticks: int) -> None:
    """Check that a time series has rows after take-off.

    Raises:
        BadInput: it has none.
    """
    if ticks < 2:
        raise BadInput(f"{path}: nothing was flown; name the folder of a run that took off")


def check_uavs(path: Path, rows: pa.Table, uavs: int) -> None:
    """Check that the rows of a time series have the UAVs of the scenario beside it.

    Raises:
        BadInput: they have others.
    """
    if (found := len(rows["x_m"][0])) != uavs:
        raise unreadable(path, OSError(f"it has {found} UAVs, and the scenario {uavs}"))


def read_checkpoint(folder: Path) -> dict[str, Any]:
    """The last checkpoint of a run: `tick`, `block`, `events_bytes` and the world's own `body`.

    Raises:
        BadInput: there is none, or it is damaged.
    """
    path = folder / CHECKPOINT
    try:
        whole = control.decode_record(paths.read(path, paths.CHECKPOINT_BYTES))
        if whole["sha256"] != _digest(whole["record"]):
            raise MessageRejected("malformed", "its checksum is wrong")
        record = control.decode_record(whole["record"])
        return {name: record[name] for name in ("tick", "block", "events_bytes", "body")}
    except FileNotFoundError as error:
        raise BadInput(f"{folder}: {go_on(folder)}") from error
    except OSError as error:
        raise BadInput(f"{path}: {error.strerror}; let it be read, then give the command again") from error
    except (MessageRejected, KeyError, TypeError) as error:
        raise BadInput(
            f"{path}: damaged, or of an older version ({error}); the run cannot be resumed: {fly_again(folder)}"
        ) from error


def _digest(*parts: bytes) -> bytes:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part)
    return digest.digest()


def _is_at(file: EventLog | Spool, path: Path) -> bool:
    """Returns whether an open file is still the one at its path."""
    try:
        return os.path.samestat(os.fstat(file.fileno()), path.stat())
    except OSError:
        return False


def to_toml(flown: Scenario) -> str:
    """The resolved scenario as a file that flies the same run again."""
    return scenario.toml_text(flown.resolved())
