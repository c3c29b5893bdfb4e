"""Base class of topologies: the hops that make a round."""

from abc import abstractmethod
from typing import Any, ClassVar, Literal, Optional, TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.federation.coding import Coding
from meanflock.swarm.declared import Declared
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import FrameKind

Role: TypeAlias = Literal["agent", "leader"]
Indices: TypeAlias = NDArray[np.intp]


class Hop(msgspec.Struct, frozen=True, eq=False):
    """One step of a round: some UAVs transmit a model each, at the same time.

    Attributes:
        label: kind of the frames, by which the radio bills them and orders their random draws.
        after: ticks from the opening of the round to the transmission.
        role: the nodes that transmit for these UAVs.
        senders: (S,) the UAVs that may transmit, ascending.
        targets: (N, T) the UAVs that each one transmits to, ascending; itself needs no radio. None: everyone.
        coding: how the models are written.
        mail: the hop whose models the senders average; None: the participants send their own models.
        ruled: the scenario's aggregation rule averages; else the mean, weighted by samples, or by the number of models.
        is_last: receivers put the model in the place of their own.
        range_m: distance beyond which a broadcast is meant for nobody, and which leaves out the sender itself; None:
            the hop has no such distance.
        is_local: nobody transmits: each sender averages its mail with its own model, and takes the average over.
    """

    label: FrameKind
    after: int
    role: Role
    senders: Indices
    targets: Indices | None
    coding: Coding
    mail: Optional["Hop"] = None
    ruled: bool = False
    is_last: bool = False
    range_m: float | None = None
    is_local: bool = False

    def reaches(self, source: NDArray[Any], target: NDArray[Any]) -> NDArray[np.bool_]:
        """Returns whether a transmission of UAV `source` (K,) is meant for UAV `target` (K,); `(K,)`."""
        if self.targets is None:
            return np.ones(len(source), dtype=bool)
        return np.asarray((self.targets[source] == target[:, None]).any(axis=-1))


class Options(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The options of a topology: none."""


class Topology:
    """Base class of topologies; override `hops`."""

    plugin_kind: ClassVar[Literal["topology"]] = "topology"
    name: ClassVar[str] = ""  # value of `federation.topology`
    bears_clusters: ClassVar[bool] = True  # false: with `federation.clusters` > 1 it is refused
    Options: ClassVar[type[msgspec.Struct]] = Options

    def __init__(self, options: Any, scenario: Scenario, declared: Declared) -> None:
        """
        Args:
            options: of the type `Options`.
            scenario: what is flown, resolved.
            declared: the declarations of the controller.
        """
        self.options, self.scenario, self.declared = options, scenario, declared

    @abstractmethod
    def hops(self) -> tuple[Hop, ...]:
        """The hops of every round, in the order of their transmissions; the last one is `is_last`.

        Hops of one label share role and coding, and no two of them transmit at once.

        Raises:
            ValueError: the scenario has no room for such a round; the text names the keys.
        """
        raise NotImplementedError
