"""What the nodes said in a tick, as it goes on the air: only what a round has room for, the silent left out."""

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from meanflock.channel.meter import Meter
from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.rounds import Rounds
from meanflock.swarm.wire.messages import FrameKind, Frames
from meanflock.swarm.wire.tick import bytes_of_batch
from meanflock.worldsim import inbound
from meanflock.worldsim.counters import Counters
from meanflock.worldsim.reporter import Note


class FrameMerger:
    """Turns the outboxes of a tick into frames: batches of a kind, of a broadcast and of a form as one, sources
    ascending.
    """

    def __init__(
        self,
        rounds: Rounds,
        counters: Counters,
        drop: Callable[[MessageRejected, str], None],
        note: Note,
    ) -> None:
        self._rounds, self._counters, self._drop, self._note = rounds, counters, drop, note

    def of(self, tick: int, sent: Iterable[Frames], awake: NDArray[np.bool_], meter: Meter) -> list[Frames]:
        """The frames of a tick; those `sent` in order of their UAVs, `awake` (N,). Their bytes go on the bill."""
        alike: dict[tuple[int, int, str, int], list[Frames]] = {}
        for batch in sent:
            broadcast = batch.round if batch.kind == FrameKind.STATE else 0
            form = batch.kind, broadcast, batch.payload.dtype.str, batch.payload.shape[1]
            alike.setdefault(form, []).append(batch)
        # In an order of their own: who is in which process decides what is said first, and shall decide nothing else.
        ordered = [alike[form] for form in sorted(alike)] if len(alike) > 1 else alike.values()
        return [frames for batches in ordered if (frames := self._joined(tick, batches, awake, meter))]

    def _joined(self, tick: int, batches: list[Frames], awake: NDArray[np.bool_], meter: Meter) -> Frames | None:
        """All batches of a kind as one, without what may not be sent."""
        together = _join(batches)
        if together is None or together.kind == FrameKind.GLOBAL or not self._is_sound(tick, together, awake):
            batches = [sound for batch in batches if (sound := self._sound_part(tick, batch, awake)) is not None]
            together = _join(batches)
        for batch in batches:
            meter.wire(batch.kind, bytes_of_batch(batch))
        return together

    def _is_sound(self, tick: int, batch: Frames, awake: NDArray[np.bool_]) -> bool:
        """Whether all of a batch is."""
        stray = inbound.stray(batch, tick, self._rounds, self._counters.averaged)
        if stray is not None:
            return False
        return b"\0" not in awake.tobytes() or bool(awake[batch.source].all())  # as a rule everyone is

    def _sound_part(self, tick: int, batch: Frames, awake: NDArray[np.bool_]) -> Frames | None:
        """What of a batch goes on the air: not what the lost and the paused say, or what is of no open round."""
        if (stray := inbound.stray(batch, tick, self._rounds, self._counters.averaged)) is not None:
            self._drop(stray, f"frames of UAV {batch.source[0]}")
            return None
        if batch.kind == FrameKind.GLOBAL:
            self._counters.rounds += 1
            self._counters.averaged = batch.round
            self._note("round", f"round {batch.round} averaged and broadcast")
            return batch
        speaks = awake[batch.source]
        if speaks.all():
            return batch
        return Frames(batch.kind, batch.round, batch.source[speaks], batch.payload[speaks]) if speaks.any() else None


def _join(batches: list[Frames]) -> Frames | None:
    """Batches of one kind as one; None where there are none, or of several rounds."""
    if len(batches) == 1:
        return batches[0]
    if len({batch.round for batch in batches}) != 1:
        return None
    source = np.concatenate([batch.source for batch in batches])
    return Frames(batches[0].kind, batches[0].round, source, np.concatenate([batch.payload for batch in batches]))
