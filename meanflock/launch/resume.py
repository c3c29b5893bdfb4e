"""State from which a run is resumed: its last checkpoint, and its rows and events up to it."""

from dataclasses import dataclass
from pathlib import Path

from meanflock.federation.plan import plan_of
from meanflock.net import keys
from meanflock.results import flown_file, flown_plugins
from meanflock.results.run_folder import SCENARIO, SUMMARY, read_checkpoint
from meanflock.results.series import states_of
from meanflock.results.stored_run import status_of
from meanflock.results.timeseries_file import Past, past
from meanflock.swarm import scenario
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario
from meanflock.worldsim.checkpoint import Resumption, decoded


@dataclass(frozen=True)
class Back:
    """An unfinished run, ready to be resumed."""

    folder: Path
    scenario: Scenario
    past: Past
    start: Resumption

    @property
    def run_id(self) -> str:
        """Name of the run, which is that of its folder."""
        return keys.check_run(self.folder.name)


def back(folder: Path) -> Back:
    """The run in `folder` at its last checkpoint.

    Raises:
        BadInput: no such run, it has finished, it died before its first checkpoint, its files are damaged, or a
            plug-in of it is not loaded.
    """
    folder = folder.resolve()
    if not (folder / SCENARIO).is_file():
        raise BadInput(f"{folder}: no run; name the folder of one that did not finish")
    if status_of(folder) == "finished":
        raise BadInput(
            f"{folder}: this run has finished, and its summary is in {SUMMARY}; fly it again with "
            f"`meanflock run {folder / SCENARIO}`"
        )
    flown = flown_file.from_copies(folder, scenario.load(folder / SCENARIO))
    flown_plugins.check(folder, flown, flown_plugins.resuming(folder))
    if not plan_of(flown).is_resumable:
        raise BadInput(
            f"{folder}: cannot be resumed: the state of the aggregation rule {flown.federation.aggregation} was in its "
            "process; fly it again"
        )
    saved = read_checkpoint(folder)
    checkpoint = decoded(saved["body"])  # first, because other versions have rows of another form, too
    rows = past(folder, saved["tick"]).rows
    start = Resumption(checkpoint, states_of(rows))
    if start.checkpoint.get("scenario") != flown.sha256():
        raise BadInput(f"{folder / SCENARIO}: not the scenario that was flown, by its checkpoint; bring that file back")
    flown_plugins.check_unchanged(folder, flown, start.checkpoint.get("plugins", ()))
    return Back(folder, flown, Past(rows, saved["block"] + 1, saved["events_bytes"]), start)
