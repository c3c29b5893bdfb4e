"""A plain tick by reflex: from the bytes of a Sense to the bytes of the Act in one call of the compiled kernel.

An agent that is one process among many finds the caches full of the others in every tick, and pays anew for each
function it enters. A tick with nothing to hear and nothing to say is therefore written once more, in C; whatever is not
plain takes the long way, with the same bits.
"""

import numpy as np

from agent.kernel import Kernel
from agent.minds import Minds
from swarm import plain


class Reflex:
    """The plain ticks of one node."""

    def __init__(self, kernel: Kernel, run: int, rows: int) -> None:
        self._kernel = kernel
        self._kinds = [(plain.senses(run, rows, report), plain.acts(run, rows, report)) for report in (False, True)]
        self._spare: Minds | None = None  # whose place the next minds take

    def __call__(self, raw: bytes, tick: int, minds: Minds) -> tuple[Minds, bytes] | None:
        """The minds after the tick and the Act, if `raw` is a plain Sense of that tick and all numbers stay in bounds.

        The minds given are the next call's to overwrite, if this one returns any.
        """
        spare = self._spare
        if spare is None:
            spare = self._spare = Minds(np.empty_like(minds.value), np.empty_like(minds.density))
        for senses, acts in self._kinds:
            answer = self._kernel.answer(raw, senses.frame(tick), acts.frame(tick), minds, spare)
            if answer is not None:
                self._spare = minds
                return spare, answer
        return None
