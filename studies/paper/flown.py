"""One flight of the grid: the engine's, with the record of what its summary does not say."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meanflock.groundstation.launch.engine import Engine
from meanflock.studies.paper.recorder import Recorder
from meanflock.studies.paper.series import Record
from meanflock.swarm.scenario import Scenario


@dataclass(frozen=True)
class Flown:
    """summary: as of every run. record: its curves, and what was traced. models: (N, 246), learned until the end."""

    scenario: Scenario
    summary: dict[str, Any]
    record: Record
    models: NDArray[np.float64]


def fly(scenario: Scenario, *, models: NDArray[np.float64] | None = None, traced: bool = False) -> Flown:
    """Flies a scenario in this process; nobody listens, nothing is written.

    Args:
        models: (N, 246), what the UAVs take off with instead of knowing nothing. traced: whether trajectory and weights
            are kept.
    """
    engine = Engine(
        scenario, f"{scenario.method}-s{scenario.seed}", memory=None if models is None else {"weights": models}
    )
    recorder = Recorder(scenario, traced=traced)
    summary = engine.complete(recorder)
    return Flown(scenario, summary, recorder.record(engine.world.flight), engine.models)
