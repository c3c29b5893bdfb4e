"""Flies swarms in which one UAV broadcasts false states, and writes the table of robustness.md.

python -m research.false_states          # 40 flights; a minute
python -m research.false_states --page   # the table again, from docs/results/false_states.json
"""

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
from msgspec import structs
from rich.console import Console
from rich.progress import track

from meanflock.launch.engine import Engine
from meanflock.net import process
from meanflock.results import statistics
from meanflock.studies import published
from meanflock.studies.markdown import replaced, table
from meanflock.swarm import scenario
from meanflock.swarm.wire.messages import FrameKind, Frames

PAGE = published.DOCS / "robustness.md"
RESULTS = published.DOCS / "results" / "false_states.json"
BEGIN, END = "<!-- table: research.false_states -->", "<!-- end of table -->"
FIRST_SEED = 197001
UAV = 7  # the UAV that broadcasts the false velocity
BOUND = 100.0  # the default of `radio.plausible_speed`, m/s
CASES = {  # name of the row → velocity that is broadcast, m/s (None: the true one), and bound of the receivers
    "true": (None, BOUND),
    "10⁶ m/s, accepted": (1e6, 1e9),
    "10⁶ m/s, rejected": (1e6, BOUND),
    "99 m/s, accepted": (99.0, BOUND),
}
KEPT = ("seed", "uavs", "arrived", "t_avg_s", "collisions", "states_refused", "ticks")
Row = dict[str, Any]


def main() -> None:
    """Fly the cases of the table, unless `--page` is set, and write the table."""
    given = published.options(__doc__, seeds=10, page=True).parse_args()
    if not given.page:
        wanted = [*product(CASES, range(FIRST_SEED, FIRST_SEED + given.seeds))]
        flights = track(wanted, "false-states", console=Console(stderr=True), transient=True)
        published.write_rows(RESULTS, [{"case": name} | flight(name, seed) for name, seed in flights])
    published.write_page(PAGE, page, RESULTS)


def flight(name: str, seed: int) -> Row:
    """One flight of `hjb` in the paper's scenario."""
    speed, bound = CASES[name]
    engine = Engine(scenario.load(None, [f"radio.plausible_speed={bound}"], method="hjb", seed=seed), "false-states")
    transmit = engine.world.air.send

    def send(tick: int, frames: Sequence[Frames], *more: Any) -> Any:
        """The medium's method; the frames are falsified first."""
        return transmit(tick, frames if speed is None else [falsified(batch, speed) for batch in frames], *more)

    engine.world.air.send = send  # type: ignore[assignment,method-assign]
    summary = engine.complete()
    return {key: summary[key] for key in KEPT}


def falsified(batch: Frames, speed: float) -> Frames:
    """The broadcasts of a tick, in which one UAV gives its position and a false velocity."""
    if batch.kind != FrameKind.STATE:
        return batch
    payload = batch.payload.copy()
    payload[batch.source == UAV, 2:] = speed / np.sqrt(2.0)
    return structs.replace(batch, payload=payload)


def page(text: str, code: str, rows: Sequence[Row]) -> str:
    """The page `text` with the table of these flights."""
    return replaced(text, BEGIN, END, ["", *lines(rows), "", published.flown_by(code), ""])


def lines(rows: Sequence[Row]) -> list[str]:
    """A row a case."""
    found = []
    for name in CASES:
        own = [row for row in rows if row["case"] == name]
        refused = sum(row["states_refused"] for row in own) / sum(row["ticks"] for row in own)
        cells = (
            f"{sum(row['arrived'] for row in own)} of {sum(row['uavs'] for row in own)}",
            *(statistics.mean([row[key] for row in own]).shown(".1f") for key in ("t_avg_s", "collisions")),
            f"{refused:.2f}",
        )
        found.append((name, *cells))
    return table(("broadcast velocity", "arrived", "travel time, s", "collisions", "states rejected a tick"), found)


if __name__ == "__main__":
    process.main(main)
