"""What the world counts of the protocol: rounds, losses, drops, residuals. The flight and the radio keep their own."""

from collections import Counter
from typing import Any

import numpy as np

from worldsim.schedule import Schedule

_SCALARS = (
    "rounds",
    "averaged",
    "held",
    "deadline_misses",
    "nodes_lost",
    "nodes_rejoined",
    "uploads_refused",
    "wall_s",
)


class Ledger:
    """The counters of one run, from take-off on, however often it was resumed."""

    def __init__(self, refused: Counter[str] | None = None) -> None:
        """`refused`: what the router keeps from the world, counted by whoever reads its log."""
        self._refused = refused if refused is not None else Counter()
        self.rounds = 0  # averaged and broadcast
        self.averaged = 0  # the last of them by number: none is averaged twice
        self.held = 0  # commands held over in real time
        self.deadline_misses = 0  # ticks with at least one of them
        self.nodes_lost = 0
        self.nodes_rejoined = 0  # admitted in flight: in the place of one that was lost, or as a standby
        self.uploads_refused = 0
        self.wall_s = 0.0  # flown before the run was resumed, s
        self.residual_max = (0.0, 0.0)  # |e_H|, |e_F|
        self.spread: float | None = None
        self.drops: Counter[str] = Counter()

    def late(self, commands: int) -> None:
        """Takes note of the commands that did not come in time in a tick of a flight in real time."""
        self.held += commands
        self.deadline_misses += commands > 0

    @property
    def dropped(self) -> Counter[str]:
        """What was not let in, by the world and by its router, by reason. Whole, whichever thread asks."""
        return self.drops.copy() + self._refused.copy()

    def residuals(self, hjb: float, fpk: float) -> None:
        """Takes note of the largest |e_H| and |e_F| of a tick."""
        most = self.residual_max
        self.residual_max = max(most[0], hjb), max(most[1], fpk)

    def snapshot(self, wall_s: float) -> dict[str, Any]:
        """All of it, for `restore`."""
        scalars = {name: getattr(self, name) for name in _SCALARS}
        return {
            **scalars,
            "wall_s": wall_s,
            "residual_max": np.array(self.residual_max),
            "spread": self.spread,
            "drops": dict(self.drops),
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Goes on with the counts of a snapshot."""
        for name in _SCALARS:
            setattr(self, name, type(getattr(self, name))(snapshot[name]))
        hjb, fpk = snapshot["residual_max"].tolist()
        self.residual_max = hjb, fpk
        self.spread = snapshot["spread"]
        self.drops = Counter(snapshot["drops"])

    def summary(self, *, schedule: Schedule | None, learns_density: bool, blocks_dropped: int) -> dict[str, Any]:
        """Its part of the summary; `schedule`: of a flight in real time."""
        return {
            "rounds": self.rounds,
            "hjb_residual_max": self.residual_max[0],
            "fpk_residual_max": self.residual_max[1] if learns_density else None,
            "weight_spread_final": self.spread,
            "nodes_lost": self.nodes_lost,
            "nodes_rejoined": self.nodes_rejoined,
            "uploads_refused": self.uploads_refused,
            "dropped_messages": dict(self.dropped),
            "held_commands": None if schedule is None else self.held,
            "realtime": None
            if schedule is None
            else {
                "factor": schedule.factor,
                "deadline_misses": self.deadline_misses,
                "tick_start_jitter_ms": schedule.jitter_ms(),
            },
            "telemetry_blocks_dropped": blocks_dropped,
        }
