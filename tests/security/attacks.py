"""What attackers of these tests are, and send."""

import numpy as np

from meanflock.swarm.net import keys
from meanflock.swarm.wire import tick
from meanflock.swarm.wire.messages import Act
from tests.security.conftest import HELD, HOLD_TICK, RUN

ME, VICTIM = "agent-3", f"agent-{HELD}"
PATIENCE_S = 0.5


def forged() -> bytes:
    """An Act that would send a UAV off at full tilt."""
    return tick.write_act(Act(keys.fingerprint(RUN), HOLD_TICK, np.array([[50.0, -50.0, 0.0, 0.0, 0.0]])))
