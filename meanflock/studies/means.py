"""Means of a study's points over their flights, as rows and as a CSV file."""

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from meanflock.channel.meter import TRAFFIC
from meanflock.results import quantities, statistics
from meanflock.swarm import durable

Summaries = Sequence[Mapping[str, Any]]


# Fields of a summary, in the order of the columns; arrivals come first.
METRICS = sorted(quantities.COMPARED, key=lambda field: field != "arrived")


@dataclass(frozen=True)
class Means:
    """Means of a study's points, in their order.

    names: names of the varied values, with units. points: the values of a point → the summaries of its flights.
    """

    names: tuple[str, ...]
    points: Mapping[tuple[Any, ...], Summaries]

    def rows(self) -> Iterator[tuple[tuple[Any, ...], dict[str, Any]]]:
        """The values of each point, and by name `n` (flights), `uavs`, and of every metric the mean under the name of
        its column and the ends of its 95 % interval under `…_low` and `…_high`; None if unknown. The mean payload of
        each kind of traffic follows under `uplink_bits`, `relay_bits`, `broadcast_bits` and `state_bits`.
        """
        for values, summaries in self.points.items():
            row: dict[str, Any] = {"n": len(summaries), "uavs": summaries[0]["uavs"]}
            for metric in METRICS:
                found = statistics.mean([quantities.number(summary, metric) for summary in summaries])
                column = quantities.table_column(metric)
                low, high = (found.low, found.high) if found.bounded else (None, None)
                row[column] = None if found.value != found.value else found.value
                row |= {f"{column}_low": low, f"{column}_high": high}
            for kind in TRAFFIC.values():
                row[f"{kind}_bits"] = sum(summary["payload_bits"][kind] for summary in summaries) / len(summaries)
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
