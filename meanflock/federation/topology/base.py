"""Base class of topologies: the hops that make a round."""

from abc import abstractmethod
from functools import cached_property
from typing import Any, ClassVar, Literal, Optional, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.federation.band import attempt_ticks
from meanflock.federation.codec import Codec
from meanflock.federation.cut import Codecs
from meanflock.federation.seat import order_of_seats, seat
from meanflock.swarm.declared import Declared
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import contains
from meanflock.swarm.wire.messages import FrameKind

Role: TypeAlias = Literal["agent", "leader"]
Averages: TypeAlias = Literal["nothing", "models", "means"]
Indices: TypeAlias = NDArray[np.intp]


class Hop(msgspec.Struct, frozen=True, eq=False):
    """One step of a round: some UAVs transmit a model each, at the same time.

    Attributes:
        label: kind of the frames, by which the radio bills them and orders their random draws.
        after: ticks from the opening of the round to the transmission.
        role: the nodes that transmit for these UAVs.
        senders: (S,) the UAVs that may transmit, ascending; of the leader's hops the nodes where it may average, of
            which one transmits.
        targets: (N, T) the nodes that each UAV transmits to, ascending; itself needs no radio. None: all UAVs.
        seats: (A,) nodes, ascending, to one of which all transmit: that where the leader averages the round. `targets`
            has the one before any fault. None: it is always the same.
        receivers: (R,) ascending, the UAVs to which a broadcast is of use; None: all. The plan sets it.
        by_station: every UAV transmits to the station that serves it, and hears that one; `targets` does not count.
        codec: how the models are written.
        averages: what arrives by the hop before, and is averaged: `nothing`, so that the participants send their own
            models; `models`, by the scenario's aggregation rule; `means`, each by what stands behind it.
        range_m: distance beyond which a broadcast is meant for nobody, and which leaves out the sender itself; None:
            the hop has no such distance.
        is_local: nobody transmits: each sender averages with its own model, and takes the average over.
        bands: (N,) the band that each UAV transmits in, with `radio.bands` = cluster; the states that it broadcasts go
            in that of its upload. None: all UAVs transmit in band 0.
        mail: the hop before, unless it averages nothing. is_last: receivers put the model in the place of their own.
        attempt_ticks: until all fragments of an attempt have arrived or are lost. The plan sets these three.
    """

    label: FrameKind
    after: int
    role: Role
    senders: Indices
    targets: Indices | None
    codec: Codec
    averages: Averages = "nothing"
    range_m: float | None = None
    is_local: bool = False
    bands: Indices | None = None
    mail: Optional["Hop"] = None
    is_last: bool = False
    attempt_ticks: int = 0
    seats: Indices | None = None
    by_station: bool = False
    receivers: Indices | None = None

    def targets_of(self, sources: Indices, seat: int) -> Indices | None:
        """The nodes (S, T) that UAVs (S,) transmit to while the leader averages at the node `seat`; None: all UAVs."""
        if self.seats is not None:
            return np.full((len(sources), 1), seat)
        return None if self.targets is None else self.targets[sources]

    def reaches(self, source: NDArray[np.integer], target: NDArray[np.integer]) -> NDArray[np.bool_]:
        """Returns whether a transmission of UAV `source` (K,) may be meant for node `target` (K,); `(K,)`."""
        if self.seats is not None:
            return contains(self.seats, target)
        if self.targets is None:
            return np.ones(len(source), dtype=bool)
        return np.asarray((self.targets[source] == target[:, None]).any(axis=-1))

    def newest_base(self, number: int) -> int:
        """The latest round from whose global model a model of round `number` can come: for an average, its own."""
        return number - (self.mail is None)


def linked(hops: tuple[Hop, ...], scenario: Scenario) -> tuple[Hop, ...]:
    """The hops of a round, each with the one before it, and with the ticks that it takes."""
    chain: list[Hop] = []
    members = scenario.members if len(scenario.members) < scenario.uavs else None
    for number, hop in enumerate(hops, start=1):
        mail = chain[-1] if chain and hop.averages != "nothing" else None
        ticks = _attempt_ticks(hop, scenario)
        chain.append(
            msgspec.structs.replace(hop, mail=mail, is_last=number == len(hops), attempt_ticks=ticks, receivers=members)
        )
    return tuple(chain)


def _attempt_ticks(hop: Hop, scenario: Scenario) -> int:
    """Ticks until all fragments of an attempt have arrived or are lost."""
    source = seat(scenario) if hop.role == "leader" else None
    return attempt_ticks(scenario, hop.codec, *_traffic(hop, scenario), source)


def _traffic(hop: Hop, scenario: Scenario) -> tuple[int, int]:
    """Number of UAVs that transmit at once in a hop by radio in the busiest band, and to how many others each."""
    if hop.is_local:
        return 0, 0
    receivers = len(scenario.members) - 1 if hop.targets is None else hop.targets.shape[1]
    if hop.role == "leader" and scenario.federation.station is not None:  # of its senders one, or all stations
        return len(scenario.stations) if hop.by_station else 1, receivers
    transmits = hop.senders
    if hop.bands is not None and hop.targets is not None:
        transmits = transmits[(hop.targets[transmits] != transmits[:, None]).any(axis=1)]
    senders = len(transmits) if hop.bands is None else int(np.bincount(hop.bands[transmits]).max(initial=0))
    return senders if hop.averages != "nothing" else min(senders, scenario.participants), receivers


class Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The options of a topology: none."""


class Topology:
    """Base class of topologies; override `hops`."""

    plugin_kind: ClassVar[Literal["topology"]] = "topology"
    name: ClassVar[str] = ""  # value of `federation.topology`
    bears_groups: ClassVar[bool] = False  # whether it uses `scenario.members`, which may be some of the UAVs
    bears_clusters: ClassVar[bool] = True  # false: with `federation.clusters` > 1 it is refused
    bears_station: ClassVar[bool] = False  # whether its leader averages at `federation.station`, or it has no leader
    by_station: ClassVar[bool] = False  # see `Hop`
    Options: ClassVar[type[msgspec.Struct]] = Options

    def __init__(self, options: Any, scenario: Scenario, declared: Declared) -> None:
        """
        Args:
            options: of the type `Options`.
            scenario: what is flown, resolved.
            declared: the declarations of the controller.
        """
        self.options, self.scenario, self.declared = options, scenario, declared

    @cached_property
    def codecs(self) -> Codecs:
        """The codecs of uploads, averages and global models."""
        return Codecs(self.scenario, self.declared)

    def check_rounds(self) -> None:
        """Raises ValueError if the method shares no model, so that there are no rounds."""
        if not self.declared.is_federated:
            raise ValueError(
                f"`method` {self.scenario.method} has no rounds; take one that shares a model, as mfgfl-hf does"
            )

    @cached_property
    def seats(self) -> Indices:
        """(A,) the nodes where the leader may average, ascending: `senders` of its hops."""
        return np.sort(order_of_seats(self.scenario))

    def to_seat(self) -> dict[str, Any]:
        """`targets`, `seats` and `by_station` of a hop to the node where the leader averages."""
        targets = np.full((self.scenario.uavs, 1), seat(self.scenario))
        seats = self.seats if len(self.seats) > 1 else None
        return {"targets": targets, "seats": seats, "by_station": self.by_station}

    def must_end(self, codec: Codec) -> bool:
        """Returns whether a round, of models written so, must be over before the next one opens.

        Whole models that are sent once, each in a band of its own, do not get in each other's way.
        """
        scenario = self.scenario
        return codec.count > 1 or scenario.federation.retries > 0 or scenario.radio.access != "fdma"

    def ticks(self, hop: Hop) -> int:
        """Ticks from the transmission of a hop until all its fragments have arrived or are lost, retries included; of
        uploads, those after `federation.deadline` are late.

        Raises:
            ValueError: no upload can be late.
        """
        scenario, deadline = self.scenario, self.scenario.federation.deadline
        one = _attempt_ticks(hop, scenario)
        if deadline is None or hop.averages != "nothing":
            return (1 + scenario.federation.retries) * one
        in_time = hop.codec.ticks - 1 + scenario.deadline_ticks
        if in_time > one:
            raise ValueError(
                f"`federation.deadline` {deadline} s is later than an upload can arrive, {one * scenario.dt:g} s; "
                "take less, or leave it out"
            )
        return scenario.federation.retries * one + in_time

    @abstractmethod
    def hops(self) -> tuple[Hop, ...]:
        """The hops of every round, in the order of their transmissions; what the last one sends is the global model.

        Hops of one label share role and codec, and no two of them transmit at once.

        Raises:
            ValueError: the scenario has no room for such a round; the text names the keys.
        """
        raise NotImplementedError
