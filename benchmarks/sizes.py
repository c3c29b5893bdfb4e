"""Messages of a tick and their sizes in bytes, which the floors use too."""

from functools import cache

import numpy as np

from meanflock.federation.plan import plan_of
from meanflock.net import tick
from meanflock.net.keys import fingerprint
from meanflock.swarm import scenario, state
from meanflock.swarm.declared import Declared
from meanflock.swarm.scenario import Radio
from meanflock.swarm.wire.control import FLOAT_OF_BITS
from meanflock.swarm.wire.messages import Act, FrameKind, Frames, Sense

RUN = fingerprint("benchmark")
TICK = 1000


@cache
def declared(method: str) -> Declared:
    """Declarations of a method's controller."""
    return plan_of(scenario.load(None, method=method)).declared


def sense(inbox: tuple[Frames, ...] = ()) -> Sense:
    """Request of one UAV."""
    return Sense(RUN, TICK, np.full((1, 2 * state.PLANE), 1.5), inbox=inbox)


def act(outbox: tuple[Frames, ...] = (), report: bool = False, method: str = "mfgfl-hf") -> Act:
    """Reply of one UAV; with its weights in a tick of reports."""
    commands = np.full((1, state.PLANE + len(declared(method).diagnostics)), 1.5)
    return Act(
        RUN, TICK, commands, models=np.full((1, declared(method).weights), 1.5) if report else None, outbox=outbox
    )


def upload(method: str, rows: int = 1) -> Frames:
    """Models on their way to the leader."""
    payload = np.full((rows, declared(method).parameters), 1.5, FLOAT_OF_BITS[Radio().bits_per_float])
    return Frames(FrameKind.UPLOAD, 5, np.arange(rows, dtype=np.int32), payload)


def broadcast(method: str) -> Frames:
    """The averaged model as one UAV receives it."""
    sent = upload(method)
    return Frames(FrameKind.GLOBAL, 5, sent.source, sent.payload, np.zeros((1, 2), dtype=np.int32))


def size(message: Sense | Act) -> int:
    """Bytes on the wire."""
    return len(tick.write_sense(message) if isinstance(message, Sense) else tick.write_act(message))
