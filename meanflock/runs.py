"""A finished run, flown in this process or read from its folder."""

import json
from collections.abc import Sequence
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_args

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from meanflock.notebook import html_of_run
from meanflock.progress import Progress, checked_progress
from meanflock.results.event_log import row_of, stored_lines
from meanflock.results.rounds_table import rounds_table, stored_rounds
from meanflock.results.run_folder import EVENTS, RECORDING, SCENARIO, SUMMARY, alone, completed, go_on
from meanflock.results.series import long_form, rows_of, states_of
from meanflock.results.summary_file import read_summary
from meanflock.results.timeseries_file import TIMESERIES, Per, read_table, write_csv
from meanflock.swarm import paths, scenario
from meanflock.swarm.errors import BadInput, available
from meanflock.swarm.events import RoundEnded
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import Telemetry

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from meanflock.results.plots.run import RunPicture

What: TypeAlias = Literal["paths", "curves"]


class Run:
    """One finished run.

    scenario: the scenario that was flown. A run from `mf.open` has the resolved scenario of its folder, in which keys
    that the method decides, such as the period of rounds, are set; `scenario.resolved()` and `scenario.sha256()` are
    equal.
    summary: the fields of summary.json. folder: the run folder; None if nothing was written.
    """

    def __init__(
        self, flown: Scenario, summary: dict[str, Any], blocks: Sequence[Telemetry] = (), folder: Path | None = None
    ) -> None:
        self.scenario = flown
        self.summary = summary
        self.folder = folder
        self._blocks = blocks

    @cached_property
    def states(self) -> NDArray[np.float64]:
        """States [x, y, vx, vy] of every tick and UAV, (T, N, 4), in m and m/s; row n is tick n."""
        if self._blocks:
            return np.concatenate([block.states for block in self._blocks])
        return states_of(self.frame())

    @cached_property
    def events(self) -> list[dict[str, Any]]:
        """The events, each a dict with tick, sim_time_s, kind, text, uavs, event (its type) and fields.

        Raises:
            BadInput: the file of events is damaged or missing.
        """
        if self._blocks:
            return [row_of(event, self.scenario.dt) for block in self._blocks for event in block.events]
        assert self.folder is not None
        path = self.folder / EVENTS
        try:
            return [dict(json.loads(line)) for line in stored_lines(path)]
        except (ValueError, TypeError, RecursionError) as error:
            raise BadInput(f"{path}: damaged: {error}; fly the run again") from error

    def rounds(self) -> pa.Table:
        """The rounds of the federation as a PyArrow table, a row each; no rows without rounds.

        Columns: round, tick, sim_time_s, opened_s, outcome, counts of uploads, `bits` and `airtime_s` since take-off,
        and the means `mean_…` of the diagnostics at the end of the round over the UAVs on the way; see docs/data.md.

        Raises:
            BadInput: the file of events is damaged or missing.
        """
        if self._blocks:
            events = [event for block in self._blocks for event in block.events]
            return rounds_table((event for event in events if isinstance(event, RoundEnded)), self.scenario.dt)
        assert self.folder is not None
        return rounds_table(stored_rounds(self.folder / EVENTS), self.scenario.dt)

    @property
    def recording(self) -> Path | None:
        """Path of the Rerun recording; None if there is none."""
        path = None if self.folder is None else self.folder / RECORDING
        return path if path is not None and path.exists() else None

    def frame(self, per: Per = "tick") -> pa.Table:
        """The time series as a PyArrow table.

        Args:
            per: "tick": one row for each tick; a column of values of UAVs has lists, one entry for each UAV. "uav":
                one row for each tick and UAV, with the columns tick, sim_time_s, uav, x_m, y_m, …, without columns of
                the swarm.

        Raises:
            BadInput: the file of the time series is damaged or missing, or `per` has another value.
        """
        _check(per)
        rows = self._rows()
        return long_form(rows) if per == "uav" else rows

    def to_pandas(self, per: Per = "uav") -> Any:
        """`frame(per)` as a pandas DataFrame.

        Raises:
            BadInput: pandas is not installed; otherwise as for `frame`.
        """
        return as_pandas(self.frame(per))

    def to_csv(self, path: str | Path, per: Per = "uav", progress: Progress | None = None) -> Path:
        """Writes the time series to a CSV file, completely or not at all. Floats read back as the same float64.

        Args:
            per: "uav": one row for each tick and UAV, as in `frame("uav")`. "tick": one row for each tick, without the
                columns of lists.
            progress: called with the number of ticks written and of all ticks.

        Returns:
            The path of the file.

        Raises:
            BadInput: the file cannot be written there; otherwise as for `frame`.
            RunFailed: the disk is full.
        """
        _check(per)
        return write_csv(self._rows(), paths.given(path), per, checked_progress(progress))

    def _rows(self) -> pa.Table:
        if self._blocks:
            return pa.Table.from_batches([rows_of(block, self.scenario.dt) for block in self._blocks])
        assert self.folder is not None
        try:
            return read_table(self.folder / TIMESERIES)
        except OSError as error:
            raise BadInput(f"{self.folder / TIMESERIES}: {error}; fly the run again") from error

    def plot(self, what: What = "paths") -> "Figure":
        """A Matplotlib figure of the flight.

        Args:
            what: "paths": the paths on the map. "curves": a panel for each quantity of the time series.

        Raises:
            BadInput: Matplotlib is not installed, or `what` has another value; otherwise as for `frame`.
        """
        if what not in get_args(What):
            raise BadInput(f'what: {what!r}; give "paths" for a map, or "curves" for panels over time')
        with available("Run.plot", "ground"):
            from meanflock.results.plots.run import plot_curves, plot_paths
        return plot_paths(self._shown()) if what == "paths" else plot_curves(self._shown())

    def _shown(self) -> "RunPicture":
        """The run for its pictures."""
        from meanflock.results.plots.run import RunPicture

        return RunPicture(self._rows(), self.scenario, self.events)

    def _repr_html_(self) -> str:
        return html_of_run(self.summary, self.folder, self._shown)

    def __repr__(self) -> str:
        flown = self.summary
        where = f" in {self.folder}" if self.folder is not None else ""
        return (
            f"<Run of {flown['method']}, {flown['uavs']} UAVs, seed {flown['seed']}: {flown['arrived']} arrived{where}>"
        )


def as_pandas(table: pa.Table) -> Any:
    """A table as a pandas DataFrame.

    Raises:
        BadInput: pandas is not installed.
    """
    if find_spec("pandas") is None:
        raise BadInput("to_pandas: pandas is not installed; `pip install pandas`, or use frame() or to_csv()")
    return table.to_pandas()


def _check(per: str) -> None:
    if per not in get_args(Per):
        raise BadInput(f'per: {per!r}; give "uav" for one row per tick and UAV, or "tick" for one row per tick')


def open_run(folder: str | Path) -> Run:
    """Opens a finished run: the folder that `meanflock run` or `mf.fly(out=…)` created.

    Raises:
        BadInput: the folder has no run, or the run has not finished.
        RunFailed: the run was killed, and there is no room for its tables.
    """
    path = paths.given(folder)
    if not (path / SCENARIO).is_file():
        raise BadInput(f"{path}: no run; name the folder of one")
    with alone(path):
        completed(path)
    if not (path / SUMMARY).exists():
        raise BadInput(f"{path}: the run has not finished: it has no {SUMMARY}; {go_on(path)}")
    try:
        summary = read_summary(path / SUMMARY)
    except BadInput as error:
        raise BadInput(f"{path}: {error}") from error
    return Run(scenario.load(path / SCENARIO), summary, folder=path)
