"""The messages of a tick as they really are, and their sizes in bytes; floors carry as many."""

import numpy as np

from meanflock.groundstation.paper.methods import Method
from meanflock.swarm import model, state
from meanflock.swarm.net.keys import fingerprint
from meanflock.swarm.scenario import Radio
from meanflock.swarm.wire import control
from meanflock.swarm.wire.control import FLOAT_OF_BITS
from meanflock.swarm.wire.messages import OUTCOME_FLOATS, Act, FrameKind, Frames, Sense

RUN = fingerprint("benchmark")
TICK = 1000  # as wide on the wire as most


def sense(inbox: tuple[Frames, ...] = ()) -> Sense:
    """What one UAV is asked."""
    return Sense(RUN, TICK, np.full((1, state.SIZE), 1.5), False, inbox)


def act(outbox: tuple[Frames, ...] = (), report: bool = False) -> Act:
    """What one UAV answers; with its whole model in a tick in which that is reported."""
    models = np.full((1, model.MODEL_FLOATS), 1.5) if report else None
    return Act(RUN, TICK, np.full((1, OUTCOME_FLOATS), 1.5), outbox=outbox, report=models)


def upload(method: Method, rows: int = 1) -> Frames:
    """Models on their way to the leader."""
    payload = np.full((rows, model.shared_floats(method)), 1.5, FLOAT_OF_BITS[Radio().bits_per_float])
    return Frames(FrameKind.UPLOAD, 5, np.arange(rows, dtype=np.int32), payload)


def broadcast(method: Method) -> Frames:
    """The averaged model as one UAV receives it."""
    sent = upload(method)
    return Frames(FrameKind.GLOBAL, 5, sent.source, sent.payload, np.zeros((1, 2), dtype=np.int32))


def of(message: Sense | Act) -> int:
    """Encoded bytes."""
    return len(control.encode(message))
