"""All outputs of a run: its folder, its recording, a viewer, and the progress of the flight."""

from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

from meanflock.launch.options import FlightOptions
from meanflock.launch.progress import FlightProgress
from meanflock.launch.station import WarningNotes
from meanflock.results.disk import coarseness
from meanflock.results.run_folder import RECORDING, RunFolder, fly_again, go_on
from meanflock.results.timeseries_file import Past
from meanflock.swarm import logs
from meanflock.swarm.scenario import Scenario
from meanflock.worldsim.reporting import BlockSink


class Outputs:
    """Context of all outputs of a run: folder, recording, viewer, progress. It completes them at its end.

    `summary` is written with the folder if it is set before the end.
    """

    def __init__(self, scenario: Scenario, run_id: str, options: FlightOptions, past: Past | None = None) -> None:
        """`past`: rows and events that the folder has already. Raises BadInput, with nothing written, if a file or port
        cannot be used.
        """
        self.summary: dict[str, Any] = {}
        self.kill: Callable[[], None] = lambda: None  # kills the processes of the swarm
        self._stack = ExitStack()
        with ExitStack() as opening:
            self.folder = opening.enter_context(RunFolder(options.out, run_id, scenario, past, options.mission))
            self.progress = FlightProgress(scenario, options.quiet)
            self.sinks: list[BlockSink] = [self.folder, self.progress, WarningNotes()]
            if options.record:
                # Here, for rerun takes a third of a second to load.
                from meanflock.recording.recorder import Recorder
                from meanflock.recording.replay import Continued, missing, recorded

                before = opening.enter_context(Continued(self.folder.path / RECORDING, run_id))
                if not options.quiet and (coarse := coarseness(scenario)) is not None:
                    logs.show(coarse)
                recorder = Recorder(scenario, before.run_id, self.folder.path / RECORDING, options.serve)
                opening.enter_context(recorder)
                if past is not None:
                    for block in missing(self.folder.path, past, recorded(before.earlier), scenario.uavs):
                        recorder.write(block)
                self.sinks.append(recorder)
                self.folder.files.append(RECORDING)
                if options.watch is not None and recorder.live_url is not None:
                    options.watch(recorder.live_url)
            opening.enter_context(self.progress)
            self._stack = opening.pop_all()

    def __enter__(self) -> "Outputs":
        return self

    @property
    def what_there_is(self) -> str:
        """Text for an interrupted run: how to fly it, or the rest of it."""
        folder = self.folder.path
        if self.folder.last_tick < 0:
            return f"nothing was flown yet; {fly_again(folder)}"
        return f"{folder} has the flight up to tick {self.folder.last_tick}; {go_on(folder)}"

    def give_up(self) -> str:
        """Stop all outputs without completing them; returns a text about the run."""
        self.kill()
        self.progress.give_up()
        return f"interrupted twice, nothing was completed; {self.what_there_is}"

    def __exit__(self, *failure: Any) -> None:
        if not self.folder.is_owner:  # a fork closes nothing of its parent: the threads that write are not in it
            if failure[1] is None and self.summary:
                self.folder.check_owner()
            return
        with self._stack.pop_all():  # closes all outputs, also after an error
            if self.summary:
                self.folder.summarise(self.summary)
            if failure[1] is not None:
                raise failure[1]
