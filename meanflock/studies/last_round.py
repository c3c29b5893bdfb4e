"""The last averaged round of a flight, which says how well its UAVs have learned."""

from typing import Any

from meanflock.results.rounds_table import MEAN, METRIC
from meanflock.swarm.events import RoundEnded
from meanflock.worldsim.tick import Row

LAST_ROUND = "last_round"  # what studies store beside the fields of a summary


class LastRound:
    """Sink that keeps the last averaged round."""

    def __init__(self) -> None:
        self._round: RoundEnded | None = None

    def write(self, row: Row) -> None:
        """Look for a round in the events of a row."""
        for event in row.events:
            if isinstance(event, RoundEnded) and event.outcome == "averaged":
                self._round = event

    @property
    def fields(self) -> dict[str, Any]:
        """Its number, bits and airtime, and the means of diagnostics and metrics as in rounds.parquet; empty without
        one."""
        if (ended := self._round) is None:
            return {}
        means = {f"{MEAN}{name}": value for name, value in ended.diagnostics.items()}
        means |= {f"{METRIC}{name}": value for name, value in ended.metrics.items()}
        return {"round": ended.number, "bits": ended.bits, "airtime_s": ended.airtime_s, **means}
