"""The messages of a tick as they really are, and their sizes in bytes; floors carry as many."""

import numpy as np

from meanflock.groundstation.paper.methods import Method
from meanflock.kernels.weights import MODEL_FLOATS, NUMBERS
from meanflock.swarm import state
from meanflock.swarm.net.keys import fingerprint
from meanflock.swarm.scenario import Radio, Scenario
from meanflock.swarm.wire.control import FLOAT_OF_BITS
from meanflock.swarm.wire.messages import Act, FrameKind, Frames, Sense
from meanflock.swarm.wire.tick import write_act, write_sense

RUN = fingerprint("benchmark")
TICK = 1000  # as wide on the wire as most


def sense(inbox: tuple[Frames, ...] = ()) -> Sense:
    """What one UAV is asked."""
    return Sense(RUN, TICK, np.full((1, state.SIZE), 1.5), inbox=inbox)


def act(outbox: tuple[Frames, ...] = (), report: bool = False) -> Act:
    """What one UAV answers; with its whole model in a tick in which that is reported."""
    models = np.full((1, MODEL_FLOATS), 1.5) if report else None
    return Act(RUN, TICK, np.full((1, NUMBERS), 1.5), outbox=outbox, models=models)


def shared_floats(method: Method) -> int:
    """Floats of the model it shares."""
    return Scenario(method=str(method)).declared.parameters


def upload(method: Method, rows: int = 1) -> Frames:
    """Models on their way to the leader."""
    payload = np.full((rows, shared_floats(method)), 1.5, FLOAT_OF_BITS[Radio().bits_per_float])
    return Frames(FrameKind.UPLOAD, 5, np.arange(rows, dtype=np.int32), payload)


def broadcast(method: Method) -> Frames:
    """The averaged model as one UAV receives it."""
    sent = upload(method)
    return Frames(FrameKind.GLOBAL, 5, sent.source, sent.payload, np.zeros((1, 2), dtype=np.int32))


def of(message: Sense | Act) -> int:
    """Encoded bytes."""
    return len(write_sense(message) if isinstance(message, Sense) else write_act(message))
