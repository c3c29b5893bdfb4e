"""A plain tick by reflex: from the bytes of a Sense to the bytes of the Act in one call of the compiled kernel.

An agent that is one process among many finds the caches full of the others in every tick, and pays anew for each
function it enters. A tick with nothing to hear and nothing to say is therefore written once more, in C. So are those of
a round: what an agent uploads does not depend on what it senses, so it is part of the bytes around its answer; and a
global model, once in the minds, leaves a Sense like any other. Whatever is not plain takes the long way, with the same
bits.
"""

import numpy as np
from numpy.typing import NDArray

from agent.kernel import Kernel
from agent.minds import Minds
from swarm import codec, model, payload, plain
from swarm.messages import Frames
from swarm.scenario import Scenario

Floats = NDArray[np.float64]


class Reflex:
    """The plain ticks of one node."""

    def __init__(self, kernel: Kernel, scenario: Scenario, run: int, uavs: NDArray[np.intp]) -> None:
        self._kernel, self._run, self._rows = kernel, run, len(uavs)
        rows = self._rows
        self._kinds = [(plain.senses(run, rows, report), plain.acts(run, rows, report)) for report in (False, True)]
        self._down = payload.broadcast(scenario)
        self._bytes = self._down.bits // 8
        layout = (1, self._down.width), self._down.dtype
        self._hearings = [
            plain.hearings(run, rows, report, layout) for report in (False, True) if scenario.method.is_federated
        ]
        self._method = scenario.method
        self._source = np.array([scenario.federation.leader], dtype="<i4").tobytes()
        self._links = np.stack([np.zeros_like(uavs), uavs], axis=-1).astype("<i4").tobytes()
        self._spare: Minds | None = None  # whose place the next minds take
        self._heard: Minds | None = None  # minds as a global model has left them

    def __call__(self, raw: bytes, tick: int, minds: Minds, upload: Frames | None = None) -> tuple[Minds, bytes] | None:
        """The minds after the tick and the Act, with that upload, if `raw` is a plain Sense of that tick and all
        numbers stay in bounds.

        The minds given are the next call's to overwrite, if this one returns any.
        """
        spare = self._spare or _like(minds)
        for report, (senses, acts) in enumerate(self._kinds):
            act = acts.frame(tick) if upload is None else self._uploads(tick, upload, bool(report))
            answer = self._kernel.answer(raw, senses.frame(tick), act, minds, spare)
            if answer is not None:
                self._spare = minds
                return spare, answer
        return None

    def hear(self, raw: bytes, tick: int, number: int, minds: Minds) -> tuple[Minds, bytes] | None:
        """The same for a Sense that brings the global model of a round to every row, and nothing else."""
        for hearings, (_, acts) in zip(self._hearings, self._kinds, strict=False):
            before, source, brought, links, end = hearings.frame(tick, number)
            head, tail = source + self._source + brought, links + self._links + end
            start = len(raw) - len(tail) - self._bytes  # of the payload
            place = start - len(head)  # of all that follows the states
            if place < 0 or not raw.startswith(head, place) or not raw.endswith(tail):
                continue
            sent = np.ndarray((1, self._down.width), self._down.dtype, raw, start)
            if not (codec.finite(sent) if self._down.is_exact else self._down.sound(sent).all()):
                return None
            heard, spare = self._overwritten(minds, self._down.decode(sent)), self._spare or _like(minds)
            answer = self._kernel.answer(raw, (before, raw[place:]), acts.frame(tick), heard, spare)
            if answer is not None:
                self._spare = minds
                return spare, answer
        return None

    def _uploads(self, tick: int, said: Frames, report: bool) -> tuple[bytes, ...]:
        """What comes before, between and after the arrays of an Act with that upload."""
        layout = said.payload.shape, said.payload.dtype
        uploads = plain.uploads(self._run, self._rows, report, layout)
        outcome, source, sent, rest, *end = uploads.frame(tick, said.round)
        return outcome, source + said.source.tobytes() + sent + said.payload.tobytes() + rest, *end

    def _overwritten(self, minds: Minds, shared: Floats) -> Minds:
        """What `minds.with_models(every row, …)` are; the same arrays every time."""
        heard = self._heard = self._heard or _like(minds)
        value, density, place = heard.value, heard.density, 0
        if self._method.shares_value:
            value[...] = np.ndarray(value.shape[1:], np.float64, shared)
            place = shared.itemsize * model.VALUE.stop
        else:
            value[...] = minds.value
        if self._method.shares_density:
            density[...] = np.ndarray(density.shape[1:], np.float64, shared, place)
        else:
            density[...] = minds.density
        return heard


def _like(minds: Minds) -> Minds:
    """Room for as many minds."""
    return Minds(np.empty(minds.value.shape), np.empty(minds.density.shape))
