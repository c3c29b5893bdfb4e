"""A learner for tests that does in a training what no learner should do."""

import os
import threading
import time

import numpy as np

import meanflock as mf


def _fork() -> None:
    if os.fork() == 0:
        os._exit(0)


def _leave_a_thread() -> None:
    threading.Thread(target=time.sleep, args=(600.0,)).start()


def _fork_in_a_thread() -> None:
    thread = threading.Thread(target=_fork)
    thread.start()
    thread.join()


HOW = {
    "exits": lambda: os._exit(3),
    "forks": _fork,
    "forks-in-a-thread": _fork_in_a_thread,
    "leaves-threads": _leave_a_thread,
}


class Misbehaving(mf.Learner):
    """Some UAVs misbehave from the second round on."""

    name = "misbehaving"
    period_ticks = 20

    class Options(mf.Options, frozen=True):
        how: str = "exits"
        uavs: tuple[int, ...] = (1,)

    @classmethod
    def initial(cls, options: "Misbehaving.Options", scenario: mf.Scenario) -> mf.Tree:
        return {"weights": np.zeros(3, np.float32)}

    def fit(self, model: mf.Tree, config: mf.Fit) -> mf.Trained:
        if self.uav in self.options.uavs and config.number >= 2:
            HOW[self.options.how]()
        model["weights"] += np.float32(1.0)  # type: ignore[call-overload]
        return mf.Trained(model, 1.0)
