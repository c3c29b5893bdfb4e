"""The results of `compare` and `sweep`: tables in the terminal, and the files of a study."""

import logging
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from meanflock.cli.study_arguments import ResultsOptions
from meanflock.cli.study_tables import (
    counts_table,
    groups_table,
    means_table,
    payload_table,
    rounds_table,
    tradeoff_table,
    until_table,
)
from meanflock.cli.tables import print_table
from meanflock.federation.plan import plan_of
from meanflock.results import flown_file, flown_plugins
from meanflock.results.plots import comparison, learning, plotstyle
from meanflock.results.plots import tradeoff as tradeoff_plot
from meanflock.results.points import labels
from meanflock.results.quantities import with_unit
from meanflock.studies import after_landing, flight_table, study_file
from meanflock.studies.each_round import EACH_ROUND
from meanflock.studies.latex import latex_table
from meanflock.studies.means import Means
from meanflock.studies.objectives import Objective, objective
from meanflock.studies.tradeoff import Tradeoff, tradeoff
from meanflock.swarm import durable, logs
from meanflock.swarm.scenario import Scenario

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Points = Mapping[tuple[Any, ...], Sequence[Mapping[str, Any]]]


class StudyResults:
    """The results of a study that is flown next.

    Attributes:
        objectives: the two of the Pareto front, if it is wanted.
    """

    def __init__(
        self, verb: str, names: Sequence[str], scenarios: Mapping[Any, Sequence[Scenario]], wanted: ResultsOptions
    ) -> None:
        """
        Args:
            names: of the varied values, without units.

        Raises:
            BadInput: a field of the Pareto front is none of these flights.
        """
        self._verb, self._names, self._scenarios, self._wanted = verb, names, scenarios, wanted
        firsts = [flights[0] for flights in scenarios.values()]
        self.objectives: list[Objective] = [objective(text, firsts, "--pareto") for text in wanted.pareto or ()]
        self._plugins = flown_plugins.files(*firsts)
        planned = (plan_of(flown).scenario for flown in firsts)
        self._read = {place: raw for flown in planned for place, raw in flown_file.contents(flown, True).items()}

    def warn(self) -> None:
        """Warn if some points look alike in figures."""
        if (points := len(self._scenarios)) > plotstyle.MOST_LOOKS:
            logs.note(
                f"figures have {plotstyle.MOST_LOOKS} looks for {points} points, so some look alike; read those in the "
                "tables, or sweep fewer values",
                logging.WARNING,
            )

    def tell(self, flown: Points) -> None:
        """Print the tables."""
        means, found = self._means(flown), self._tradeoff(flown)
        firsts = [flights[0] for flights in self._scenarios.values()]
        sizes = {one.uavs for one in firsts}
        title = f"{self._verb}: {sizes.pop()} UAVs" if len(sizes) == 1 else self._verb
        shown = [
            means_table(means, title, [one.duration for one in firsts]),
            counts_table(means),
            until_table(means),
            payload_table(means),
            rounds_table(means),
            groups_table(means),
            tradeoff_table(means, found) if found else None,
        ]
        for table in filter(None, shown):
            print_table(table)
        after_landing.warn(firsts, [summary for summaries in flown.values() for summary in summaries])

    def write(self, flown: Points, out: Path) -> list[Path]:
        """Write all files; study.json last, when the others are whole. Returns their paths.

        Raises:
            BadInput: a file cannot be made.
            RunFailed: the disk is full.
        """
        means, found = self._means(flown), self._tradeoff(flown)
        places = {at: {"pareto": found.placed[at].place} if found else {} for at in flown}
        written = [
            means.write_csv(out / f"{self._verb}.csv", places),
            durable.put(out / f"{self._verb}.tex", latex_table(means, found).encode()),
            *flight_table.write_tables(self._names, flown, out),
            *plotstyle.write(self._figures(flown, found), out, self._wanted.figures),
        ]
        flown_plugins.keep(out, self._plugins)
        flown_file.keep(out, self._read)
        command = shlex.join(["meanflock", *click.get_current_context().obj])
        record = study_file.study_record(command, self._names, self._scenarios, flown, out)
        return [*written, study_file.write(record, out)]

    def _means(self, flown: Points) -> Means:
        return Means(tuple(map(with_unit, self._names)), flown)

    def _tradeoff(self, flown: Points) -> Tradeoff | None:
        return tradeoff(flown, *self.objectives) if self.objectives else None

    def _figures(self, flown: Points, found: Tradeoff | None) -> "dict[str, Figure]":
        columns, over = self._wanted.columns, self._wanted.over
        figures = {self._verb: comparison.plot_points(self._names, flown, columns)}
        rounds = {at: [summary[EACH_ROUND] for summary in summaries] for at, summaries in flown.items()}
        if drawn := learning.plot_learning(self._names, rounds, over, columns):
            figures[f"learning-over-{over}"] = drawn
        named, looks = labels(self._names, flown), comparison.point_looks(self._names, flown)
        points = [
            tradeoff_plot.TradeoffPoint(named[at], looks[at], one.x, one.y, one.place)
            for at, one in (found.placed.items() if found else ())
            if one.place
        ]
        if found and points:
            unknown = [named[at] for at, one in found.placed.items() if not one.place]
            figures["pareto"] = tradeoff_plot.plot_tradeoff(points, found.x.label, found.y.label, columns, unknown)
        return figures
