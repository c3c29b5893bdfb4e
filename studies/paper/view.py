"""The result tables as columns of numbers: select rows, read a metric by seed. See `tables.py` for what is in them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from meanflock.studies.code_version import version
from meanflock.studies.paper.tables import Results
from meanflock.studies.store import DATA
from meanflock.swarm.errors import BadInput

Floats = NDArray[np.float64]

COORDINATE = {
    "uavs": "uavs",
    "period": "period",
    "period-tied": "period",
    "wind": "sigma",
    "offline": "sigma",
    "trained": "sigma",
}  # experiment → the column its grid runs along
MEASURED = "theory.json"


class Frame:
    """Rows of a table. Columns become arrays when they are asked for; null becomes NaN."""

    def __init__(self, table: pa.Table) -> None:
        self._table = table

    def __len__(self) -> int:
        return int(self._table.num_rows)

    def __contains__(self, name: str) -> bool:
        return name in self._table.column_names

    def __getitem__(self, name: str) -> NDArray[Any]:
        """A column: float64 for numbers and truth values, objects for text, `(rows, n)` for lists."""
        column = self._table.column(name).combine_chunks()
        if pa.types.is_list(column.type):
            return np.array(column.to_pylist(), dtype=np.float64)
        if pa.types.is_string(column.type):
            return np.array(column.to_pylist(), dtype=object)
        return column.cast(pa.float64()).to_numpy(zero_copy_only=False)

    def where(self, **equal: Any) -> "Frame":
        """The rows whose columns equal the values given; numbers to one part in a billion."""
        table = self._table
        for name, value in equal.items():
            column = table.column(name)
            if isinstance(value, float):
                near = pc.less_equal(pc.abs(pc.subtract(column, value)), 1e-9 * max(1.0, abs(value)))
                table = table.filter(near)
            else:
                table = table.filter(pc.equal(column, value))
        return Frame(table)

    def distinct(self, name: str) -> list[Any]:
        """The values of a column, ascending, without null."""
        return sorted(value for value in pc.unique(self._table.column(name)).to_pylist() if value is not None)

    def by_seed(self, metric: str) -> dict[int, float]:
        """seed → value; empty where the metric is not recorded.

        Raises:
            ValueError: a seed has several rows.
        """
        if metric not in self or not len(self):
            return {}
        seeds = self["seed"].astype(int).tolist()
        if len(set(seeds)) < len(seeds):
            raise ValueError(f"{metric}: several runs a seed; select by setting or trained too")
        return dict(zip(seeds, self[metric].tolist(), strict=True))


def paired(*columns: Mapping[int, float]) -> list[Floats]:
    """The values of the seeds all columns have, in the order of the seeds."""
    seeds = sorted(set.intersection(*(set(column) for column in columns))) if columns else []
    return [np.array([column[seed] for seed in seeds]) for column in columns]


@dataclass(frozen=True)
class View:
    """The tables of a grid as frames, and what `measure.py` measured: name → a value a seed."""

    runs: Frame
    series: Frame
    trajectories: Frame
    weights: Frame
    measured: Mapping[str, Sequence[float]]

    @classmethod
    def of(cls, results: Results, measured: Mapping[str, Sequence[float]] | None = None) -> "View":
        """The frames of what `tables.load` or `run_grid` returned."""
        return cls(
            Frame(results.runs),
            Frame(results.series),
            Frame(results.trajectories),
            Frame(results.weights),
            measured or {},
        )

    def cell(self, experiment: str, method: str, point: float | None = None, **more: Any) -> Frame:
        """The runs of a method in an experiment, at one point of its grid or at all; `more` as in `where`."""
        frame = self.runs.where(experiment=experiment, method=method, **more)
        return frame if point is None else frame.where(**{COORDINATE[experiment]: float(point)})

    def values(
        self, experiment: str, method: str, metric: str, point: float | None = None, **more: Any
    ) -> dict[int, float]:
        """A metric of these runs: seed → value."""
        return self.cell(experiment, method, point, **more).by_seed(metric)

    def points(self, experiment: str) -> list[float]:
        """The points of an experiment's grid, ascending."""
        return [float(point) for point in self.runs.where(experiment=experiment).distinct(COORDINATE[experiment])]


class _Measured(msgspec.Struct):
    version: str  # of the code measured, as in `runs`
    seeds: list[int]
    seconds: float
    numbers: dict[str, list[float]]


def load_measured(
    out: Path, seeds: Sequence[int] | None = None, seconds: float | None = None
) -> dict[str, list[float]]:
    """What `keep_measured` wrote; empty if nothing, or if code, seeds or seconds (where given) have changed since."""
    path = out / DATA / MEASURED
    if not path.is_file():
        return {}
    try:
        kept = msgspec.json.decode(path.read_bytes(), type=_Measured)
    except msgspec.MsgspecError as error:
        raise BadInput(f"{path}: {error}; delete it and measure again") from error
    fits = kept.version == version() and seeds in (None, kept.seeds) and seconds in (None, kept.seconds)
    return kept.numbers if fits else {}


def keep_measured(out: Path, numbers: Mapping[str, Sequence[float]], seeds: Sequence[int], seconds: float) -> None:
    """Writes what `measure` found where `load_measured` looks for it."""
    kept = _Measured(version(), list(seeds), seconds, {name: list(values) for name, values in numbers.items()})
    (out / DATA).mkdir(parents=True, exist_ok=True)
    (out / DATA / MEASURED).write_bytes(msgspec.json.format(msgspec.json.encode(kept)) + b"\n")
