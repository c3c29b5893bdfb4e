"""What the world counts of the protocol: rounds, losses, drops, residuals. The flight and the radio keep their own."""

from collections import Counter
from typing import Any


class Counters:
    """The counters of one run, from take-off on, however often it was resumed."""

    def __init__(self, refused: Counter[str] | None = None) -> None:
        """`refused`: messages that the bus dropped, by reason."""
        self._refused = refused if refused is not None else Counter()
        self.held = 0  # commands held over in real time
        self.deadline_misses = 0  # ticks with at least one of them
        self.nodes_lost = 0
        self.nodes_rejoined = 0  # admitted in flight: in the place of one that was lost, or as a standby
        self.uploads_refused = 0
        self.states_refused = 0  # received states that were not believed, a tick and a UAV that sent them
        self.disbelieved: set[int] = set()  # the UAVs that sent them
        self.wall_s = 0.0  # flown before the run was resumed, s
        self.spread: float | None = None
        self.drops: Counter[str] = Counter()

    def late(self, commands: int) -> None:
        """Takes note of the commands that did not come in time in a tick of a flight in real time."""
        self.held += commands
        self.deadline_misses += commands > 0

    @property
    def dropped(self) -> Counter[str]:
        """What was not let in, by the world and by its bus, by reason. Whole, whichever thread asks."""
        return self.drops.copy() + self._refused.copy()

    def snapshot(self, wall_s: float) -> dict[str, Any]:
        """All of it, for `restore`."""
        return {
            **self._numbers(),
            "wall_s": wall_s,
            "spread": self.spread,
            "drops": dict(self.drops),
            "disbelieved": sorted(self.disbelieved),
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Goes on with the counts of a snapshot."""
        for name, number in self._numbers().items():
            setattr(self, name, type(number)(snapshot[name]))
        self.spread = snapshot["spread"]
        self.drops = Counter(snapshot["drops"])
        self.disbelieved = set(snapshot["disbelieved"])

    def _numbers(self) -> dict[str, int | float]:
        return {name: value for name, value in vars(self).items() if isinstance(value, int | float)}
