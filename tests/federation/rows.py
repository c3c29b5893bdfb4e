"""The learner of a node, for tests of its part in the rounds."""

import numpy as np


class Rows:
    """Rows that share no model; `silence` names the UAVs that send nothing."""

    def __init__(self, uavs: tuple[int, ...] | range, floats: int = 108) -> None:
        self.uavs, self.silence, self._floats = np.array(uavs), np.zeros(0, dtype=int), floats

    def models_to_send(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return rows[:0], np.zeros((0, self._floats))

    def take(self, rows: np.ndarray, models: np.ndarray) -> None:
        raise AssertionError("no model of the leader is delivered here")

    def silent(self) -> np.ndarray:
        return np.isin(self.uavs, self.silence)
