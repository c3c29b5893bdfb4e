"""A tick of hjb by reflex: everyone has said where it is, and everyone was heard by everyone, or all but over one link.

Most ticks are like this. Which states came, and for whom, is then known beforehand and told by the bytes of the Sense;
whatever else came takes the long way, with the same bits.
"""

from collections import defaultdict

import numpy as np
from numpy.typing import NDArray

from agent.minds import Minds
from swarm import plain, state
from swarm.plain import Plain
from swarm.scenario import Scenario

Floats = NDArray[np.float64]

_LINK = np.dtype("<i8")  # the two numbers of a link as one
_SAID = 3  # arrays of an Act without a report
_NONE = np.zeros(0, dtype=np.intp)


class Chorus:
    """What a node of M UAVs hears of N that are all in range of each other, and how it answers."""

    def __init__(self, scenario: Scenario, run: int, uavs: NDArray[np.intp], float_: np.dtype) -> None:
        """`uavs`: (M,), ascending. `float_`: of a state as it is broadcast."""
        rows, everyone = len(uavs), scenario.uavs
        heard = np.arange(everyone) if rows > 1 else np.delete(np.arange(everyone), uavs)  # one alone not itself
        row, target = (heard[:, None] != uavs).nonzero()
        links = np.stack([row, uavs[target]], axis=-1).astype("<i4")
        self._columns = slice(None) if rows > 1 else heard
        self._own = np.arange(rows) * everyone + uavs  # of M · N states, those of the UAVs themselves,
        self._place = target * everyone + heard[row]  # and those that come over the links
        self._all = links.tobytes()
        self._links = np.frombuffer(self._all, _LINK)
        self._heard, self._names = heard.astype("<i4").tobytes(), uavs.astype("<i4")
        came, said = (((count, state.SIZE), float_) for count in (len(heard), rows))
        self._kinds: defaultdict[int, list[tuple[Plain, Plain]]] = defaultdict(list)  # by the bytes of the Sense
        for count in plain.chorus_links(rows, len(heard)):
            for report in (False, True):
                senses = plain.choruses(run, rows, report, came, count)
                self._kinds[senses.size].append((senses, plain.broadcasts(run, rows, report, said)))

    @staticmethod
    def serves(rows: int, everyone: int) -> bool:
        """Whether a node of so many UAVs of so many is likely to hear all others, and there are any."""
        return bool(plain.chorus_links(rows, everyone - (rows == 1)))

    def hear(self, raw: bytes, tick: int, known: Floats) -> tuple[Floats, Plain] | None:
        """The states (M, 4) in a Sense of that tick and the kind of its answer, or None if it is not a plain one.

        What was heard in it replaces what was `known` (M, N, 4), as do these states; if None, none does.
        """
        for senses, acts in self._kinds.get(len(raw) - plain.size_of(tick), ()):
            if (arrays := senses.decode(tick, raw)) is not None:
                states, source, payload, links = arrays
                if source.tobytes() != self._heard or (lost := self._lost(links)) is None:
                    return None
                flat = known.reshape(-1, state.SIZE)
                kept = flat[lost] if len(lost) else None
                known[:, self._columns] = payload
                if kept is not None:
                    flat[lost] = kept
                flat[self._own] = states
                return states, acts
        return None

    def answer(self, acts: Plain, tick: int, outcome: Floats, said: NDArray[np.floating], minds: Minds) -> bytes:
        """The Act: outcome (M, 5), the states (M, 4) as they are broadcast, and the models where they are wanted."""
        report = [minds.models()] if acts.arrays > _SAID else []
        return acts.encode(tick, outcome, self._names, said, *report)

    def _lost(self, links: NDArray[np.int32]) -> NDArray[np.intp] | None:
        """Which of the M · N states did not come, (0,) or (1,); None if the links are not all others in their order."""
        told = links.tobytes()
        if told == self._all:
            return _NONE
        here = np.frombuffer(told, _LINK)
        if len(here) != len(self._links) - 1:
            return None
        differ = here != self._links[:-1]
        first = int(differ.argmax()) if differ.any() else len(here)
        size = _LINK.itemsize
        return self._place[first : first + 1] if told[size * first :] == self._all[size * (first + 1) :] else None
