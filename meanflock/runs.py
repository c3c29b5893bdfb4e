"""A run that was flown: here, or in the folder it left."""

import json
from collections.abc import Callable, Sequence
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from meanflock.groundstation.results.event_log import row_of
from meanflock.groundstation.results.run_folder import EVENTS, RECORDING, SCENARIO, SUMMARY, alone
from meanflock.groundstation.results.series import long_form, rows_of, states_of
from meanflock.groundstation.results.timeseries_file import TIMESERIES, Per, read_table, recover, write_csv
from meanflock.swarm import scenario
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import Telemetry

Progress = Callable[[int, int], None]  # ticks written, and all ticks


class Run:
    """One finished run.

    scenario: what was flown; of `mf.open` the one of the folder, in which what the method decides, as the period of
    rounds, is written out: `scenario.resolved()` and `scenario.sha256()` of both are equal. summary: as in
    summary.json. folder: where it is on disk; None if nowhere.
    """

    def __init__(
        self, flown: Scenario, summary: dict[str, Any], blocks: Sequence[Telemetry] = (), folder: Path | None = None
    ) -> None:
        self.scenario, self.summary, self.folder = flown, summary, folder
        self._blocks = blocks

    @cached_property
    def states(self) -> NDArray[np.float64]:
        """[x, y, vx, vy] of every tick and UAV, (T, N, 4), m and m/s; row n is tick n."""
        if self._blocks:
            return np.concatenate([block.states for block in self._blocks])
        return states_of(self.frame())

    @cached_property
    def events(self) -> list[dict[str, Any]]:
        """What happened: tick, sim_time_s, kind, text, uavs.

        Raises:
            BadInput: the file of them is damaged or gone.
        """
        if self._blocks:
            return [row_of(event, self.scenario.dt) for block in self._blocks for event in block.events]
        assert self.folder is not None
        path = self.folder / EVENTS
        try:
            return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
        except OSError as error:
            raise BadInput(f"{path}: {error.strerror}; fly the run again") from error
        except ValueError as error:
            raise BadInput(f"{path}: damaged: {error}; fly the run again") from error

    @property
    def recording(self) -> Path | None:
        """The Rerun recording, if there is one."""
        path = None if self.folder is None else self.folder / RECORDING
        return path if path is not None and path.exists() else None

    def frame(self, per: Per = "tick") -> pa.Table:
        """The time series as a table of PyArrow.

        Args:
            per: "tick": a row a tick, in which a column of a UAV's values is a list with an entry a UAV. "uav": a row a
                tick and UAV, with the columns tick, sim_time_s, uav, x_m, y_m, … without those of the whole swarm.

        Raises:
            BadInput: the file of it is damaged or gone, or `per` is something else.
        """
        _check(per)
        rows = self._rows()
        return long_form(rows) if per == "uav" else rows

    def to_pandas(self, per: Per = "uav") -> Any:
        """`frame(per)` as a DataFrame, where pandas is installed.

        Raises:
            BadInput: pandas is not installed; else as `frame`.
        """
        if find_spec("pandas") is None:
            raise BadInput("to_pandas: pandas is not installed; `pip install pandas`, or use frame() or to_csv()")
        return self.frame(per).to_pandas()

    def to_csv(self, path: str | Path, per: Per = "uav", progress: Progress | None = None) -> Path:
        """Writes the time series to a CSV file, whole or not at all. Every float reads back as the same float64.

        Args:
            per: "uav": a row a tick and UAV, as in `frame("uav")`. "tick": a row a tick, with the columns of the whole
                swarm; columns of lists are left out.
            progress: called with the ticks written and all ticks.

        Returns:
            The path of the file.

        Raises:
            BadInput: no file can be made there; else as `frame`.
            RunFailed: the disk is full.
        """
        _check(per)
        return write_csv(self._rows(), Path(path), per, progress or (lambda _done, _all: None))

    def _rows(self) -> pa.Table:
        if self._blocks:
            return pa.Table.from_batches([rows_of(block, self.scenario.dt) for block in self._blocks])
        assert self.folder is not None
        try:
            return read_table(self.folder / TIMESERIES)
        except OSError as error:
            raise BadInput(f"{self.folder / TIMESERIES}: {error}; fly the run again") from error

    def __repr__(self) -> str:
        flown = self.summary
        where = f" in {self.folder}" if self.folder is not None else ""
        return (
            f"<Run of {flown['method']}, {flown['uavs']} UAVs, seed {flown['seed']}: {flown['arrived']} arrived{where}>"
        )


def _check(per: str) -> None:
    if per not in get_args(Per):
        raise BadInput(f'per: {per!r}; give "uav" for a row a tick and UAV, or "tick" for a row a tick')


def open_run(folder: str | Path) -> Run:
    """The finished run in a folder that `meanflock run` or `mf.fly(out=…)` left.

    Raises:
        BadInput: there is none, or it has not finished.
    """
    path = Path(folder)
    if not (path / SCENARIO).is_file():
        raise BadInput(f"{path}: no run; name the folder of one")
    with alone(path):
        recover(path)
    try:
        summary = json.loads((path / SUMMARY).read_text(encoding="utf-8"))
    except OSError as error:
        raise BadInput(
            f"{path}: the run has not finished ({SUMMARY}: {error.strerror}); `meanflock resume` it"
        ) from error
    except ValueError as error:
        raise BadInput(f"{path / SUMMARY}: not JSON: {error}") from error
    return Run(scenario.load(path / SCENARIO), summary, folder=path)
