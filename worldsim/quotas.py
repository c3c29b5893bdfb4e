"""How long a message to the world may be: as long as the scenario lets an honest one of that role become."""

from functools import lru_cache

from meanflock.swarm.errors import MessageRejected
from meanflock.swarm.net import keys
from meanflock.swarm.net.bus import Quota
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire import control
from meanflock.worldsim.limits import Limits
from meanflock.worldsim.members import LEADER

JOIN_BYTES, RECEIVED_BYTES = 256, 64
_STRANGE = Quota("", 0)  # whatever is under no key of a node


class Quotas:
    """The quota of every key the world listens on; may be asked from any thread."""

    def __init__(self, run: str, scenario: Scenario, limits: Limits, rows_at_most: int | None = None) -> None:
        """`rows_at_most`: UAVs one agent may hold; None: as many as there are."""
        self._run = run
        rows = min(rows_at_most or scenario.uavs, scenario.uavs)
        self._agent = min(limits.act(rows), control.MAX_BYTES)
        self._leader = min(limits.act(0), control.MAX_BYTES)
        self.largest = max(self._agent, self._leader, JOIN_BYTES, RECEIVED_BYTES)  # of all, bytes
        self._known = lru_cache(maxsize=4096)(self._of)

    def __call__(self, key: str) -> Quota:
        """Whose messages are under `key`, and the most bytes one of them may have."""
        return self._known(key)

    def _of(self, key: str) -> Quota:
        if key == keys.received(self._run):
            return Quota(key, RECEIVED_BYTES)
        try:
            name = keys.node_of(key).partition(".")[0]  # all lives of a node share its quota
        except MessageRejected:
            return _STRANGE
        if key.endswith("/join"):
            return Quota(f"{name} joining", JOIN_BYTES)
        if not key.endswith("/act"):
            return Quota(name, 0)
        return Quota(name, self._leader if name == LEADER else self._agent)
