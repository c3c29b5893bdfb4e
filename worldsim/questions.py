"""The Senses of a tick in which nobody receives anything, or everyone no more than the global model.

Most ticks are such. Their questions differ in little, so they are cut from one string: where every UAV has a node of
its own, that takes a third of the time of as many messages.
"""

import numpy as np

from swarm import plain
from swarm.messages import Frames, Sense
from swarm.state import States
from worldsim import inbox
from worldsim.members import Member


class Questions:
    """Those of one tick; what they are is what `swarm.plain.encode` makes of each Sense."""

    def __init__(self, run: int, tick: int, report: bool, states: States, brought: Frames | None = None) -> None:
        """`states`: (N, 4), everyone's. `brought`: what `inbox.only_a_model` found."""
        self._run, self._tick, self._report = run, tick, report
        self._states, self._everyone, self._size = states, states.tobytes(), states.itemsize * states.shape[1]
        self._plain: dict[int, tuple[bytes, ...]] = {}  # what is around the states, by the UAVs of a node
        self._brought = brought
        self._hears = b""
        if brought is not None and brought.links is not None:
            hears = np.zeros(len(states), dtype=bool)
            hears[brought.links[:, 1]] = True
            self._hears = hears.tobytes()
            links = np.stack([np.zeros(len(states)), np.arange(len(states))], axis=-1).astype("<i4")
            self._links, self._link = links.tobytes(), links.itemsize * links.shape[1]
            self._hearing: dict[int, tuple[bytes, ...]] = {}  # what is around states and links

    def of_each(self, rows: int, firsts: list[int]) -> list[bytes] | None:
        """Those to nodes of so many UAVs, numbered without gaps from these on.

        None where a node may receive the model for some of them.
        """
        everyone, size, hears = self._everyone, self._size, self._hears
        states = [everyone[first * size : (first + rows) * size] for first in firsts]
        before, after = self._frame(rows)
        if self._brought is None:
            return [before + own + after for own in states]
        if rows > 1 and b"\0" in hears:
            return None
        links, size = self._links, self._link
        head, between, tail = self._frame_of_model(rows, self._brought)
        return [
            head + own + between + links[first * size : (first + rows) * size] + tail
            if hears[first]
            else before + own + after
            for first, own in zip(firsts, states, strict=True)
        ]

    def of(self, member: Member) -> bytes:
        """That to a node."""
        place, rows = member.place, member.rows
        if not isinstance(place, slice):
            return self._any(member)
        first, end = place.start, place.stop
        states = self._everyone[first * self._size : end * self._size]
        if self._brought is None or not (hearing := self._hears.count(1, first, end)):
            before, after = self._plain.get(rows) or self._frame(rows)
            return before + states + after
        if hearing < rows:
            return self._any(member)
        before, between, after = self._hearing.get(rows) or self._frame_of_model(rows, self._brought)
        return before + states + between + self._links[first * self._link : end * self._link] + after

    def _any(self, member: Member) -> bytes:
        heard = () if self._brought is None else inbox.of_agent(member, [self._brought], len(self._states))
        return plain.encode(Sense(self._run, self._tick, self._states[member.place], self._report, heard))

    def _frame(self, rows: int) -> tuple[bytes, ...]:
        frame = self._plain[rows] = plain.senses(self._run, rows, self._report).frame(self._tick)
        return frame

    def _frame_of_model(self, rows: int, brought: Frames) -> tuple[bytes, ...]:
        source, payload = brought.source, brought.payload
        hearing = plain.hearings(self._run, rows, self._report, (payload.shape, payload.dtype))
        before, to_source, to_payload, to_links, after = hearing.frame(self._tick, brought.round)
        between = to_source + source.tobytes() + to_payload + payload.tobytes() + to_links
        frame = self._hearing[rows] = before, between, after
        return frame
