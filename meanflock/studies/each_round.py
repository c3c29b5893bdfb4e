"""The rounds of a flight, which a study stores beside the fields of its summary."""

from typing import Any

from meanflock.results.rounds_table import MEAN, METRIC, row_of_round
from meanflock.swarm.events import RoundEnded
from meanflock.worldsim.tick import Row

EACH_ROUND = "each_round"  # rows of all rounds, as in rounds.parquet
LAST_ROUND = "last_round"  # fields of the last averaged round, which say how well the UAVs have learned
_OF_THE_LAST = ("round", "bits", "airtime_s")


class EachRound:
    """Sink that collects the rows of all rounds; a tick takes `dt` seconds."""

    def __init__(self, dt: float) -> None:
        self._dt = dt
        self._rows: list[dict[str, Any]] = []

    def write(self, row: Row) -> None:
        """Look for rounds in the events of a row."""
        self._rows += [row_of_round(event, self._dt) for event in row.events if isinstance(event, RoundEnded)]

    @property
    def fields(self) -> dict[str, Any]:
        """All rounds, and of the last averaged one number, bits, airtime, and means of diagnostics and metrics."""
        last: dict[str, Any] = next((row for row in reversed(self._rows) if row["outcome"] == "averaged"), {})
        means = {name: value for name, value in last.items() if name in _OF_THE_LAST or name.startswith((MEAN, METRIC))}
        return {LAST_ROUND: means, EACH_ROUND: self._rows}
