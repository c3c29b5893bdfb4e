"""`mf.Comparison`: the result of a study, as rows of means, as a table with a row for each flight, and as a plot."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa

from meanflock.notebook import html_of_means
from meanflock.runs import as_pandas
from meanflock.studies import flight_table, study
from meanflock.studies.means import Means
from meanflock.swarm import paths
from meanflock.swarm.errors import BadInput, available

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Comparison:
    """The result of a study. Iterate over it to get one row for each point, or take the row of one:
    `study["orca"]`, and where several values vary `study[0.1, "orca"]`.

    A row is a dict. It has the values that identify the point, `n` (flights), `uavs`, and for each metric the mean
    under its name, the ends of its 95 % interval under `…_low` and `…_high`, and under `…_verdict` whether the point is
    significantly `best`, or `worse` than the best, paired by seed, `equal` or `undecided`; None if unknown.
    `uplink_bits`, `relay_bits`, `broadcast_bits` and `state_bits` are the mean payload by kind of traffic; `rounds` and
    `rounds_void` follow. If any flight averaged a round, `last_round_…` are means of the numbers of the last one, over
    the `last_round_n` flights of the point that averaged one. In means over UAVs a UAV that never arrived counts with
    the duration. A notebook shows the means as a table.
    """

    def __init__(self, names: tuple[str, ...], flown: Mapping[tuple[Any, ...], study.Summaries]) -> None:
        self.means = Means(names, flown)

    def __iter__(self) -> Iterator[dict[str, Any]]:
        for values, row in self.means.rows():
            yield dict(zip(self.means.names, values, strict=True)) | row

    def __getitem__(self, values: Any) -> dict[str, Any]:
        """The row of a point, by its value or several: `study["orca"]`, `study[0.1, "orca"]`.

        Values that are the same at all points may be left out.

        Raises:
            BadInput: there is no such point.
        """
        wanted = [(values,), values]
        varying = {point: tuple(point[place] for place in self.means.varying) for point in self.means.points}
        for row, (point, shorter) in zip(self, varying.items(), strict=True):
            if point in wanted or shorter in wanted:
                return row
        names = ", ".join(self.means.names[place] for place in self.means.varying)
        points = "; ".join(", ".join(map(repr, shorter)) for shorter in varying.values())
        raise BadInput(f"{values!r}: no point of this study; name values of {names}: {points}")

    def __len__(self) -> int:
        return len(self.means.points)

    def __repr__(self) -> str:
        flights = sum(map(len, self.means.points.values()))
        points = f"{len(self)} point{'s' * (len(self) != 1)}"
        return f"<Comparison of {points} of {', '.join(self.means.names)}: {flights} flight{'s' * (flights != 1)}>"

    def _repr_html_(self) -> str:
        return html_of_means(self.means)

    @property
    def summaries(self) -> Mapping[tuple[Any, ...], Sequence[Mapping[str, Any]]]:
        """The summaries of all flights, by point; `each_round` has the rounds, `last_round` the last averaged one, and
        `failures` why UAVs were lost, or rules or trainings failed."""
        return self.means.points

    def frame(self) -> pa.Table:
        """A PyArrow table with a row for each flight.

        Its columns are the values that identify the point, and then all fields of the summary under their dotted keys,
        as `payload_bits.total` and `provenance.commit`; null if unknown. The list `radio.links` is left out. Values
        that are lists or tables are JSON.
        """
        return flight_table.flight_table(self.means.names, self.means.points)

    def rounds(self) -> pa.Table:
        """A PyArrow table with a row for each round of each flight.

        Its columns are the values that identify the point, `method`, `learner` if any flight has one, `seed`, and
        those of rounds.parquet; null if unknown.
        """
        return flight_table.rounds_table(self.means.names, self.means.points)

    def to_pandas(self) -> Any:
        """`frame()` as a pandas DataFrame.

        Raises:
            BadInput: pandas is not installed.
        """
        return as_pandas(self.frame())

    def to_csv(self, path: str | Path) -> Path:
        """Writes `frame()` to a CSV file, completely or not at all; an empty cell is unknown.

        Returns:
            The path of the file.

        Raises:
            BadInput: the file cannot be written there.
            RunFailed: the disk is full.
        """
        return flight_table.write_csv(self.frame(), paths.given(path))

    def to_parquet(self, path: str | Path) -> Path:
        """Writes `frame()` to a Parquet file; returns and raises as `to_csv`."""
        return flight_table.write_parquet(self.frame(), paths.given(path))

    def plot(self) -> "Figure":
        """A Matplotlib figure: a panel for each metric, with the means and their 95 % intervals.

        A comparison has a row for each controller. A sweep is drawn along its first key, with a line for each
        controller and each combination of the other keys; more than 120 lines share looks.

        Raises:
            BadInput: Matplotlib is not installed.
        """
        with available("Comparison.plot", "ground"):
            from meanflock.results.plots.comparison import plot_points
        return plot_points(self.means.names, self.means.points)
