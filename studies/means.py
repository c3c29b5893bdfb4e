"""What a study found, a row a point: means over its flights, and as a CSV file."""

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from meanflock.groundstation import statistics
from meanflock.groundstation.quantities import number
from meanflock.swarm import durable

Summaries = Sequence[Mapping[str, Any]]


@dataclass(frozen=True)
class Metric:
    """A number of a summary: its dotted key, its column in a CSV file, and its heading in a table with its unit."""

    key: str
    column: str
    heading: str


METRICS = (
    Metric("arrived", "arrived_uavs", "arrived\n(UAVs)"),
    Metric("t_avg_censored_s", "t_avg_censored_s", "travel\ntime\n(s)"),
    Metric("energy_mean_J", "energy_mean_J", "motion\nenergy\n(J)"),
    Metric("payload_bits.total", "payload_bits", "payload\n({}bit)"),
    Metric("phi_A", "phi_A_m_s", "align-\nment\nφ_A\n(m/s)"),
    Metric("phi_C_distinct", "phi_C_distinct", "risk\nφ_C of\npairs\n(1)"),
    Metric("collisions", "collisions_pairs", "colli-\nsions\n(pairs)"),
)


@dataclass(frozen=True)
class Means:
    """Means of a study's points, in their order.

    names: what tells the points apart, with units. points: their values → the summaries of their flights.
    """

    names: tuple[str, ...]
    points: Mapping[tuple[Any, ...], Summaries]

    def rows(self) -> Iterator[tuple[tuple[Any, ...], dict[str, Any]]]:
        """Of each point its values, and by name `n` (flights), `uavs`, and of every metric the mean under its column
        and the ends of its 95 % interval under `…_low` and `…_high`; None where unknown.
        """
        for values, summaries in self.points.items():
            row: dict[str, Any] = {"n": len(summaries), "uavs": summaries[0]["uavs"]}
            for metric in METRICS:
                found = statistics.mean([number(summary, metric.key) for summary in summaries])
                low, high = (found.low, found.high) if found.bounded else (None, None)
                row[metric.column] = None if found.value != found.value else found.value
                row |= {f"{metric.column}_low": low, f"{metric.column}_high": high}
            yield values, row

    def write_csv(self, path: Path) -> Path:
        """Writes means and the ends of their 95 % intervals; an empty cell is unknown.

        Raises:
            RunFailed: the disk is full.
        """
        text = io.StringIO()
        lines = csv.writer(text, lineterminator="\n")
        rows = list(self.rows())
        lines.writerow([*self.names, *rows[0][1]])
        lines.writerows([*values, *row.values()] for values, row in rows)
        return durable.put(path, text.getvalue().encode())
