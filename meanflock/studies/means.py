"""Means of a study's points over their flights, as rows and as a CSV file."""

import csv
import io
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from meanflock.channel.meter import TRAFFIC
from meanflock.results import quantities, statistics
from meanflock.studies.each_round import LAST_ROUND
from meanflock.studies.verdicts import Verdict, verdicts
from meanflock.swarm import durable

Summaries = Sequence[Mapping[str, Any]]


# Fields of a summary, in the order of the columns; arrivals come first.
METRICS = sorted(quantities.COMPARED, key=lambda field: field != "arrived")


ROUNDS = ("rounds", "rounds_void")


@dataclass(frozen=True)
class Means:
    """Means of a study's points, in their order.

    names: names of the varied values, with units. points: the values of a point → the summaries of its flights.
    """

    names: tuple[str, ...]
    points: Mapping[tuple[Any, ...], Summaries]

    @property
    def varying(self) -> list[int]:
        """Places of the varied values that are not the same everywhere; all, if there is one point."""
        places = range(len(self.names))
        return [place for place in places if len({point[place] for point in self.points}) > 1] or [*places]

    @cached_property
    def verdicts(self) -> Mapping[tuple[tuple[Any, ...], str], Verdict]:
        """Whether each point is significantly best, by the point and the metric."""
        return verdicts(self.names, self.points)

    def rows(self) -> Iterator[tuple[tuple[Any, ...], dict[str, Any]]]:
        """The values of each point, and its numbers by name.

        First come `n` (flights) and `uavs`. Each metric has its mean under the name of its column, the ends of the
        95 % interval under `…_low` and `…_high`, and the verdict under `…_verdict`; None if unknown. The mean payload
        of each kind of traffic follows under `uplink_bits`, `relay_bits`, `broadcast_bits` and `state_bits`, then
        `rounds` and `rounds_void`. If any flight averaged a round, the numbers of the last one follow under
        `last_round_…`, as means over the `last_round_n` flights of the point that averaged one; a flight whose round
        lacks a number does not count in its mean.
        """
        numbers = dict.fromkeys(
            name for summaries in self.points.values() for fields in _last_rounds(summaries) for name in fields
        )
        for values, summaries in self.points.items():
            row: dict[str, Any] = {"n": len(summaries), "uavs": summaries[0]["uavs"]}
            for metric in METRICS:
                column = quantities.table_column(metric)
                row |= _mean(column, [quantities.number(each, metric) for each in summaries])
                row[f"{column}_verdict"] = self.verdicts.get((values, metric))
            for kind in TRAFFIC.values():
                row[f"{kind}_bits"] = sum(summary["payload_bits"][kind] for summary in summaries) / len(summaries)
            for metric in ROUNDS:
                row |= _mean(metric, [quantities.number(each, metric) for each in summaries])
            found = _last_rounds(summaries)
            row |= {f"{LAST_ROUND}_n": len(found)} if numbers else {}
            for name in numbers:
                row |= _mean(f"{LAST_ROUND}_{name}", [fields[name] for fields in found if name in fields])
            yield values, row

    def write_csv(self, path: Path, more: Mapping[tuple[Any, ...], dict[str, Any]]) -> Path:
        """Writes means, the ends of their 95 % intervals and verdicts; an empty cell is unknown.

        Args:
            more: further columns, for each point.

        Raises:
            RunFailed: the disk is full.
        """
        text = io.StringIO()
        lines = csv.writer(text, lineterminator="\n")
        rows = [(values, row | more[values]) for values, row in self.rows()]
        lines.writerow([*self.names, *rows[0][1]])
        lines.writerows([*values, *row.values()] for values, row in rows)
        return durable.put(path, text.getvalue().encode())


def _last_rounds(summaries: Summaries) -> list[Mapping[str, float]]:
    """The last round of each flight that averaged one."""
    return [summary[LAST_ROUND] for summary in summaries if summary.get(LAST_ROUND)]


def _mean(column: str, values: Sequence[float]) -> dict[str, float | None]:
    """The mean and the ends of its 95 % interval; None if unknown."""
    found = statistics.mean(values)
    low, high = (found.low, found.high) if found.bounded else (None, None)
    return {column: None if math.isnan(found.value) else found.value, f"{column}_low": low, f"{column}_high": high}
