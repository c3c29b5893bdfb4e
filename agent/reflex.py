"""A plain tick by reflex: from the bytes of a Sense to the bytes of the Act in one call of the compiled kernel.

An agent that is one process among many finds the caches full of the others in every tick, and pays anew for each
function it enters. A tick with nothing to hear and nothing to say is therefore written once more, in C. So are those of
a round: what an agent uploads does not depend on what it senses, so it is part of the bytes around its answer; and a
global model, once in the minds, leaves a Sense like any other. Whatever is not plain takes the long way, with the same
bits.
"""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from agent.kernel import Kernel, Kinds
from agent.minds import Minds
from swarm import codec, model, payload, plain
from swarm.messages import Frames
from swarm.scenario import Scenario

Floats = NDArray[np.float64]
Side: TypeAlias = tuple[Minds, Callable[[bytes, int], bytes | None]]  # minds, and the tick that begins with them


class Reflex:
    """The plain ticks of one node."""

    def __init__(self, kernel: Kernel, scenario: Scenario, run: int, uavs: NDArray[np.intp]) -> None:
        self._kernel, self._run, self._rows = kernel, run, len(uavs)
        rows = self._rows
        self._senses = [plain.senses(run, rows, report).pieces() for report in (False, True)]
        self._acts = [plain.acts(run, rows, report).pieces() for report in (False, True)]
        self._kinds = tuple(zip(self._senses, self._acts, strict=True))
        self._down = payload.broadcast(scenario)
        self._bytes = self._down.bits // 8
        layout = (1, self._down.width), self._down.dtype
        self._hearings = [
            plain.hearings(run, rows, report, layout) for report in (False, True) if scenario.method.is_federated
        ]
        if rows == 1 and scenario.method.is_federated:  # all that can be uploaded; made while nobody waits, and kept
            up = payload.upload(scenario)
            for report in (False, True):
                plain.uploads(run, rows, report, ((rows, up.width), up.dtype))
        self._method = scenario.method
        self._source = np.array([scenario.federation.leader], dtype="<i4").tobytes()
        self._links = np.stack([np.zeros_like(uavs), uavs], axis=-1).astype("<i4").tobytes()
        self._heard: Minds | None = None  # minds as a global model has left them
        self._both: tuple[Side, Side] | None = None  # sides of the last tick

    def __call__(self, raw: bytes, tick: int, minds: Minds) -> tuple[Minds, bytes] | None:
        """The minds after the tick and the Act, if `raw` is a plain Sense of that tick and all numbers stay in bounds.

        The minds given are the next call's to overwrite, if this one returns any.
        """
        here, there = self.sides(minds)
        return None if (answer := here[1](raw, tick)) is None else (there[0], answer)

    def upload(self, raw: bytes, tick: int, said: Frames, minds: Minds) -> tuple[Minds, bytes] | None:
        """The same where the Act uploads that."""
        layout = said.payload.shape, said.payload.dtype
        for report, senses in enumerate(self._senses):  # those that want a report are few
            uploads = plain.uploads(self._run, self._rows, bool(report), layout)
            before, between, source, sent, rest, *end = uploads.pieces(said.round)
            act = before, between, source + said.source.tobytes() + sent + said.payload.tobytes() + rest, *end
            if answered := self._once(raw, tick, ((senses, act),), minds, minds):
                return answered
        return None

    def hear(self, raw: bytes, tick: int, number: int, minds: Minds) -> tuple[Minds, bytes] | None:
        """The same for a Sense that brings the global model of a round to every row, and nothing else."""
        for hearings, acts in zip(self._hearings, self._acts, strict=False):
            before, between, source, brought, links, end = hearings.pieces(number)
            head, tail = source + self._source + brought, links + self._links + end
            start = len(raw) - len(tail) - self._bytes  # of the payload
            place = start - len(head)  # of all that follows the states
            if place < 0 or not raw.startswith(head, place) or not raw.endswith(tail):
                continue
            sent = np.ndarray((1, self._down.width), self._down.dtype, raw, start)
            if not (codec.finite(sent) if self._down.is_exact else self._down.sound(sent).all()):
                return None
            heard = self._overwritten(minds, self._down.decode(sent))
            if answered := self._once(raw, tick, (((before, between, raw[place:]), acts),), heard, minds):
                return answered
        return None

    def _once(self, raw: bytes, tick: int, kinds: Kinds, begin: Minds, minds: Minds) -> tuple[Minds, bytes] | None:
        """A tick of other kinds, which begins with other minds than those that are given back."""
        after = self.sides(minds)[1][0]
        return None if (answer := self._kernel.turn(kinds, begin, after)(raw, tick)) is None else (after, answer)

    def sides(self, minds: Minds) -> tuple[Side, Side]:
        """The side of these minds, and the other: ticks go from one to the other and back."""
        if self._both is None or all(minds is not side[0] for side in self._both):
            after, turn = _like(minds), self._kernel.turn
            self._both = (minds, turn(self._kinds, minds, after)), (after, turn(self._kinds, after, minds))
        here, there = self._both
        return (here, there) if here[0] is minds else (there, here)

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
