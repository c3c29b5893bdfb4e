"""Events of the nodes: they join, fail, are lost and return; and the end of a flight."""

from typing import NamedTuple, TypeAlias

from meanflock.swarm.events.base import BaseEvent, Count, Uavs


class NodesJoined(BaseEvent, frozen=True):
    """All nodes are there. swarm: number of UAVs."""

    meanings = {"joined": "all nodes have joined; the flight begins"}
    nodes: Count
    swarm: Count

    @property
    def text(self) -> str:
        return f"{self.nodes} nodes hold {self.swarm} UAVs"


class FlightResumed(BaseEvent, frozen=True):
    """All nodes are there, and the flight continues. swarm: number of UAVs."""

    meanings = {"resumed": "the flight continues from a checkpoint"}
    nodes: Count
    swarm: Count

    @property
    def text(self) -> str:
        return f"{self.nodes} nodes hold {self.swarm} UAVs and continue from tick {self.tick}"


class FlightFailed(BaseEvent, frozen=True):
    """The flight cannot go on."""

    meanings = {"failed": "the flight ends: every agent was lost and none came back, or a plug-in of the world failed"}
    reason: str

    @property
    def text(self) -> str:
        return self.reason


class FlightFinished(BaseEvent, frozen=True):
    """The flight is over. arrived: number of UAVs that arrived, of all in the `swarm`."""

    meanings = {"finished": "the flight is over"}
    arrived: Count
    swarm: Count

    @property
    def text(self) -> str:
        return f"{self.arrived} of {self.swarm} arrived"


class NodeLost(BaseEvent, frozen=True):
    """A node without UAVs in flight is lost: a leader, or an agent before take-off or of UAVs that are lost already."""

    meanings = {"lost": "a leader is lost, or an agent whose UAVs are not flying"}
    level = "ERROR"
    node: str
    reason: str

    @property
    def text(self) -> str:
        return f"{self.node}: {self.reason}"


class NodeIsSlow(BaseEvent, frozen=True):
    """A node delays the others."""

    meanings = {"slow": "a node makes the others wait tick after tick, and is lost if it continues"}
    level = "WARN"
    node: str
    reason: str

    @property
    def text(self) -> str:
        return f"{self.node}: {self.reason}"


class LastReturn(BaseEvent, frozen=True):
    """A node has rejoined as often as it may."""

    meanings = {"refused": "a node has rejoined for the last time"}
    node: str

    @property
    def text(self) -> str:
        return f"{self.node} rejoined for the last time: its place stays closed after the next loss"


class LeaderStandsBy(BaseEvent, frozen=True):
    """A leader joined in flight."""

    meanings = {"rejoined": "a standby leader has joined"}
    node: str

    @property
    def text(self) -> str:
        return f"{self.node} stands by"


class LeaderTookOver(BaseEvent, frozen=True):
    """A standby leads in place of a lost leader. before: name of the lost leader."""

    meanings = {"leader": "another leader takes over"}
    node: str
    before: str

    @property
    def text(self) -> str:
        return f"{self.node} takes over from {self.before}"


class _Failure(BaseEvent, frozen=True):
    """Base class of failures that nodes report."""

    node: str
    failure: str

    @property
    def text(self) -> str:
        return f"{self.node}: {self.failure}"


class LeaderFailed(_Failure, frozen=True):
    """A leader reports a failure."""

    meanings = {"leader": "a leader reports a failure"}


class AgentFailed(_Failure, frozen=True):
    """An agent reports a failure."""

    meanings = {"agent": "an agent reports a failure"}


class FitFailed(_Failure, frozen=True):
    """A training of a learner gave no model."""

    meanings = {"training": "a training gave no model, so its UAV is silent in the round"}
    level = "WARN"
    uav: Count

    @property
    def uavs(self) -> Uavs:
        return (self.uav,)


class AverageFailed(_Failure, frozen=True):
    """The aggregation rule failed at some UAVs."""

    meanings = {"rule": "an aggregation rule failed at UAVs, which average nothing in the round"}
    level = "WARN"
    uavs: Uavs


class GlobalDraw(BaseEvent, frozen=True):
    """Plug-ins draw from a global random generator.

    Attributes:
        plugins: those of which one does: all of the flight that are not meanflock's own.
    """

    meanings = {"random": "a plug-in, for the first time, has drawn from a global random generator of Python or NumPy"}
    level = "WARN"
    plugins: tuple[str, ...]

    @property
    def text(self) -> str:
        return (
            f"{' or '.join(self.plugins)} draws from a global random generator, so other processes fly another flight; "
            "draw from mf.seeds.generator instead, or from what the method is given"
        )


class NoCheckpoint(BaseEvent, frozen=True):
    """A checkpoint was due, and too large."""

    meanings = {"checkpoint": "a checkpoint, for the first time, was too large to be stored"}
    level = "WARN"
    reason: str

    @property
    def text(self) -> str:
        return f"no checkpoint is stored: {self.reason}; a run without one cannot be resumed"


class FailedController(NamedTuple):
    """Report of an agent: the controller failed with some of its UAVs."""

    uavs: tuple[int, ...]
    failure: str


class FailedTraining(NamedTuple):
    """Report of an agent: a training of a UAV gave no model."""

    uav: int
    failure: str

    @property
    def uavs(self) -> tuple[int]:
        return (self.uav,)


class FailedAverage(NamedTuple):
    """Report of an agent: the aggregation rule failed at some of its UAVs."""

    uavs: tuple[int, ...]
    failure: str


class FoundDraw(NamedTuple):
    """Report of a node: a plug-in of its process draws from a global random generator."""


# What a node reports to the world.
Problem: TypeAlias = str | FailedController | FailedTraining | FailedAverage | FoundDraw


class Dropped(BaseEvent, frozen=True):
    """A message was rejected. origin: its key or its sender. error: the reason under which it is counted, and more."""

    meanings = {"dropped": "a message was refused (the first ones are named; the summary counts all, by reason)"}
    level = "WARN"
    origin: str
    reason: str
    error: str

    @property
    def text(self) -> str:
        return f"{self.origin}: {self.error}"
