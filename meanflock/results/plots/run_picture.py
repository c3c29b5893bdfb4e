"""A run as its pictures read it: time series, scenario and events, and its UAVs by colour."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from meanflock.results.flown import FlownKeys
from meanflock.results.plots import plotstyle
from meanflock.results.series import per_uav
from meanflock.swarm import mission
from meanflock.swarm.scenario import Scenario

Floats = NDArray[np.float64]


class RunPicture(NamedTuple):
    """A run for its pictures: its time series, its scenario, and its events as rows of events.jsonl."""

    table: pa.Table
    scenario: FlownKeys | Scenario
    events: Sequence[Mapping[str, Any]]

    def grid(self, column: str) -> Floats:
        """A column of the time series with a number a UAV, (T, N)."""
        return per_uav(self.table, column)[..., 0].astype(np.float64)

    def line(self, column: str) -> Floats:
        """A column of the time series with a number of the swarm, (T,)."""
        return np.asarray(self.table.column(column).to_numpy(), dtype=np.float64)


class UavPart(NamedTuple):
    """UAVs of one colour and dash. name: of their group; empty without groups."""

    name: str
    rows: slice
    colour: str
    dash: plotstyle.Dash = plotstyle.SOLID


def parts_of(flown: FlownKeys | Scenario) -> list[UavPart]:
    """The UAVs by group; without groups all in one."""
    if not flown.groups:
        return [UavPart("", slice(None), plotstyle.colour(flown.method))]
    return [
        UavPart(group.name, rows, plotstyle.group_colour(number), plotstyle.group_dash(number))
        for number, (group, rows) in enumerate(mission.parts(flown))
    ]
