"""Delivery: the part of the arriving frames that is for one agent."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from meanflock.federation.post import only
from meanflock.swarm.ascending import contains
from meanflock.swarm.wire.messages import Frames
from meanflock.worldsim.members import Member


def of_agents(due: Iterable[Frames], awake: NDArray[np.bool_]) -> list[Frames]:
    """The frames over links to UAVs that are `awake` (N,)."""
    arrived = [batch for batch in due if batch.links is not None]
    if arrived and not awake.all():
        arrived = [only(batch, batch.links[awake[batch.links[:, 1]]]) for batch in arrived if batch.links is not None]
    return [batch for batch in arrived if batch.links is not None and len(batch.links)]


def of_agent(member: Member, arrived: Iterable[Frames], uavs: int) -> tuple[Frames, ...]:
    """Of what arrived at `uavs` UAVs, the links to an agent's, and the payloads they need."""
    own = []
    for batch in arrived:
        assert batch.links is not None
        links, targets = batch.links, batch.links[:, 1]
        if member.rows < uavs:
            links = links[targets == member.uavs[0] if member.rows == 1 else contains(member.uavs, targets)]
        if len(links):
            own.append(only(batch, links))
    return tuple(own)
