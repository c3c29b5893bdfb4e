"""The sound answers of a tick, told by their bytes: what a node does, the models it reports, what it says by radio.

Nearly all answers are such; they are read in the thread that brings them, without a message being made of them. What
is not sound, says more, or says the same in other bytes, is None here, and `swarm.codec` and `inbound.check` judge it.
"""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from swarm import payload, plain, state
from swarm.codec import FLOAT_OF_BITS
from swarm.messages import FrameKind, Frames
from swarm.methods import Method
from swarm.plain import Plain
from swarm.rounds import Rounds
from swarm.scenario import Scenario
from worldsim import kernel
from worldsim.members import Member

# What one node of M UAVs answered: the bytes of its outcome, (M, 5) f8; those of its models, (M, 246) f8, none where
# none were asked for; its frames, without links.
Answer: TypeAlias = tuple[bytes, bytes, tuple[Frames, ...]]
Splitter: TypeAlias = Callable[[bytes], tuple[bytes, ...] | None]


class Answers:
    """Those that are expected in one tick after the other."""

    def __init__(self, scenario: Scenario, run: int) -> None:
        self._scenario, self._run, self._rounds = scenario, run, Rounds(scenario)
        self._coding = payload.upload(scenario)
        self._state = FLOAT_OF_BITS[scenario.radio.bits_per_float]
        self.open(-1, False)

    def open(self, tick: int, reporting: bool) -> None:
        """The tick, and whether nodes report their models in it."""
        self._tick, self._reporting = tick, reporting
        self._number = self._rounds.opens(tick)
        self._kinds: dict[int, list[tuple[FrameKind | None, Splitter]]] = {}  # by the UAVs of a node

    def read(self, member: Member, raw: bytes) -> Answer | None:
        """The answer of a node that holds UAVs; None for whatever else this is."""
        if not (rows := member.rows):
            return None
        for kind, split in self._kinds.get(rows) or self._expected(rows):
            if (parts := split(raw)) is None:
                continue
            report = parts[-1] if self._reporting else b""
            if kind is None:
                return parts[0], report, ()
            batch = self._batch(kind, member, *parts[1:3])
            return None if batch is None else (parts[0], report, (batch,))
        return None

    def _expected(self, rows: int) -> list[tuple[FrameKind | None, Splitter]]:
        """The kinds of answers, the likeliest first, and what tells them."""
        run, reporting = self._run, self._reporting
        kinds: list[tuple[FrameKind | None, Plain]] = [(None, plain.acts(run, rows, reporting))]
        if self._scenario.method is Method.HJB:
            layout = (rows, state.SIZE), self._state
            kinds.insert(0, (FrameKind.STATE, plain.broadcasts(run, rows, reporting, layout)))
        elif self._number and rows == 1:  # of more than one there is no telling which take part
            layout = (rows, self._coding.width), self._coding.dtype
            kinds.insert(0, (FrameKind.UPLOAD, plain.uploads(run, rows, reporting, layout)))
        told = [(kind, kernel.splitter(acts, self._tick, self._number)) for kind, acts in kinds]
        self._kinds[rows] = told
        return told

    def _batch(self, kind: FrameKind, member: Member, source: bytes, said: bytes) -> Frames | None:
        """What all UAVs of a node say, if these are they."""
        if source != member.names:
            return None
        is_upload = kind == FrameKind.UPLOAD
        dtype = self._coding.dtype if is_upload else self._state
        table = np.frombuffer(said, dtype).reshape(member.rows, -1)
        if is_upload and not (self._coding.is_exact or self._coding.sound(table).all()):
            return None
        return Frames(kind, self._number if is_upload else 0, np.frombuffer(source, "<i4"), table)
