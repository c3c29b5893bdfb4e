"""A plain tick by reflex: from the bytes of a Sense to the bytes of the Act in one call of the compiled kernel.

An agent that is one process among many finds the caches full of the others in every tick, and pays anew for each
function it enters. A tick with nothing to hear and nothing to say is therefore written once more, in C. So are those of
a round: the one in which the agent uploads what it had learned before, and the one in which it hears the global model
and goes on from there. What they are to say and to hear is known beforehand: as texts with gaps (`swarm.plain`), which
the kernel fills. Whatever is not plain takes the long way, with the same bits.
"""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from agent.kernel import MODELS, OUTCOME, REPORT, SOURCE, STATES, Answer, Kernel
from agent.minds import Minds
from swarm import model, payload, plain
from swarm.payload import Coding
from swarm.plain import Template
from swarm.rounds import Rounds
from swarm.scenario import Scenario

# How a tick is answered: the ticks around it that are answered alike; by what; and what that wants to be told, which is
# the number of the round and the places of the rows that upload, (S,) intp.
Found: TypeAlias = tuple[range, Answer, int, bytes]

_WIDTHS = (4, 8)  # bytes of the floats the kernel writes and reads


class Reflex:
    """The plain ticks of one node, which has its minds here."""

    def __init__(
        self,
        kernel: Kernel,
        scenario: Scenario,
        run: int,
        uavs: NDArray[np.intp],
        rounds: Rounds,
        ahead: range,
        minds: Minds,
        *,
        uploads: bool,
    ) -> None:
        """`ahead`: the ticks in which those of the `rounds` open that are drawn. `minds`: of the UAVs, to begin with;
        the arrays are the reflex's from now on. `uploads`: whether models are uploaded as they are, but for the width
        of their floats."""
        self._kernel, self._run, self._rows, self._rounds = kernel, run, len(uavs), rounds
        self._names = uavs.astype("<i4").tobytes()
        room = Minds(np.empty_like(minds.value), np.empty_like(minds.density))
        self._both = minds, room
        self._sides = kernel.sides(*self._both)
        rows = self._rows
        self._senses = [plain.senses(run, rows, report).template(STATES) for report in (False, True)]
        acts = [plain.acts(run, rows, report).template(OUTCOME, *[REPORT][:report]) for report in (False, True)]
        asked, answered = self._senses, acts
        down = payload.broadcast(scenario)
        hears = scenario.method.is_federated and _is_written(down)
        self._shared = model.shared(scenario.method)
        if hears:
            asked, answered = asked + self._hearings(down, scenario.federation.leader, uavs), acts + acts
        models = (1, self._coding(down)) if hears else ()
        self._listening = kernel.turn(self._sides, tuple(zip(asked, answered, strict=True)), *models)
        up = payload.upload(scenario)
        self._up = up if uploads and scenario.method.is_federated and _is_written(up) else None
        self._uploading: dict[int, Answer] = {}  # by how many rows take part
        soon = [tick for opens in ahead for tick in (opens, opens + 1)][:-1]  # what comes after is not drawn
        self._ahead = {tick: self._found(tick) for tick in soon}  # found while nobody waits

    @property
    def minds(self) -> Minds:
        """What the UAVs have learned; the arrays are a later tick's to overwrite."""
        return self._both[self._sides.side]

    def learn(self, minds: Minds) -> None:
        """Goes on with these, which were learned the long way."""
        here = self.minds
        here.value[...] = minds.value
        here.density[...] = minds.density

    def at(self, tick: int) -> Found | None:
        """How this tick is answered, or None where it takes the long way."""
        return self._ahead.pop(tick, None) or self._found(tick)

    def _found(self, tick: int) -> Found | None:
        if ticks := self._rounds.quiet(tick):
            return ticks, self._listening, self._rounds.last(tick), b""
        number = self._rounds.opens(tick)
        if not number:
            return None  # heads of clusters relay
        rows = self._rounds.rows(number)
        if not len(rows):
            return range(tick, tick + 1), self._listening, number, b""
        if self._up is None:
            return None
        answer = self._uploading.get(len(rows)) or self._uploading_of(self._up, len(rows))
        return range(tick, tick + 1), answer, number, rows.tobytes()

    def _uploading_of(self, up: Coding, count: int) -> Answer:
        sent = (count, up.width), up.dtype
        acts = []
        for report in (False, True):
            gaps = [OUTCOME, SOURCE, MODELS, *[REPORT][:report]]
            acts.append(plain.uploads(self._run, self._rows, report, sent).template(*gaps))
        kinds = tuple(zip(self._senses, acts, strict=True))
        answer = self._kernel.turn(self._sides, kinds, count, self._coding(up), self._names)
        self._uploading[count] = answer
        return answer

    def _hearings(self, down: Coding, leader: int, uavs: NDArray[np.intp]) -> list[Template]:
        source = np.array([leader], dtype="<i4").tobytes()
        links = np.stack([np.zeros_like(uavs), uavs], axis=-1).astype("<i4").tobytes()
        came = (1, down.width), down.dtype
        hearings = [plain.hearings(self._run, self._rows, report, came) for report in (False, True)]
        return [hearing.template(STATES, source, MODELS, links) for hearing in hearings]

    def _coding(self, coding: Coding) -> tuple[int, int, int, float]:
        return self._shared.start, self._shared.stop, coding.dtype.itemsize, coding.largest


def _is_written(coding: Coding) -> bool:
    """Whether the kernel writes and reads models like this."""
    return coding.is_exact and coding.dtype.itemsize in _WIDTHS
