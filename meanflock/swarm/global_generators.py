"""Global random generators of Python, NumPy and torch: only trainings of learners draw from them, seeded.

A plug-in that draws from them flies one trajectory in one process and another in many.
"""

import random
import sys
from typing import Any

import numpy as np

from meanflock.swarm.declared import MEMORY_TICKS


class Generators:
    """Global generators of Python, NumPy and torch, which code has to itself while it runs, at intervals or once.

    A context. It begins with seeded generators, goes on with what the last use left, and restores those of others.
    """

    in_use = 0  # contexts of this process that are open
    uses = 0  # that were ever opened

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._own: tuple[Any, Any, Any] | None = None  # after the last use
        self._others: tuple[Any, Any, Any] = _states()

    def __enter__(self) -> None:
        Generators.in_use += 1
        Generators.uses += 1
        self._others = _states()
        if self._own is not None:
            _set_states(self._own)
            return
        random.seed(self._seed)
        np.random.seed(self._seed % 2**32)  # noqa: NPY002
        if (torch := sys.modules.get("torch")) is not None:
            torch.manual_seed(self._seed)

    def __exit__(self, *_: object) -> None:
        self._own = _states()
        _set_states(self._others)
        Generators.in_use -= 1


class DrawWatch:
    """Watch that tells once whether plug-ins of this process drew from a global generator since it began.

    It compares states from time to time, because that takes as long as a tick of few UAVs. While a training has the
    generators to itself it compares nothing.
    """

    def __init__(self) -> None:
        self._before = _undisturbed()
        self._next_tick = 1  # after the first tick, in which most plug-ins were called
        self._has_found = False

    def finds_a_draw(self, tick: int) -> bool:
        """Returns whether a draw is found in a tick, which is looked for every `MEMORY_TICKS` ticks."""
        if tick < self._next_tick:
            return False
        self._next_tick = tick + MEMORY_TICKS
        return self.finds_a_draw_now()

    def finds_a_draw_now(self) -> bool:
        """Returns whether a draw is found now; False if an earlier one was."""
        if self._has_found or (now := _undisturbed()) is None:
            return False
        self._before = self._before or now
        self._has_found = now != self._before
        return self._has_found


def global_state() -> tuple[Any, ...]:
    """State of the global generators of Python and NumPy, to compare."""
    numpy: Any = np.random.get_state()  # noqa: NPY002
    return random.getstate(), *(part.tobytes() if isinstance(part, np.ndarray) else part for part in numpy)


def _undisturbed() -> tuple[Any, ...] | None:
    """State of the global generators; None while a training, which has a thread of its own, has them to itself."""
    uses = Generators.uses
    if Generators.in_use:
        return None
    now = global_state()
    return now if Generators.uses == uses else None


def _states() -> tuple[Any, Any, Any]:
    """States of the global generators; None for torch where it is not loaded."""
    torch = sys.modules.get("torch")
    return random.getstate(), np.random.get_state(), None if torch is None else torch.get_rng_state()  # noqa: NPY002


def _set_states(states: tuple[Any, Any, Any]) -> None:
    """Set the states of the global generators; torch keeps its own if there is none for it."""
    python, numpy, torch_state = states
    random.setstate(python)
    np.random.set_state(numpy)  # noqa: NPY002
    if torch_state is not None:
        sys.modules["torch"].set_rng_state(torch_state)
