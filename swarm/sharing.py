"""How UAVs say where they are: what a controller that shares states, or a filter, can be told of it."""

from typing import Annotated, Literal

from msgspec import Meta

from meanflock.swarm.table import Table


class Sharing(Table, frozen=True):
    """When a UAV broadcasts its state, and how long others believe it; derive options from it."""

    broadcast: Annotated[
        Literal["tick", "event"],
        Meta(description="every tick, four floats; or 64 bits whenever others predict the position too badly"),
    ] = "event"
    delta_m: Annotated[
        float, Meta(gt=0, description="δ of an event, how far the position may be from what others predict, m")
    ] = 0.3
    velocity_delta_m_s: Annotated[
        float, Meta(ge=0, description="the same of the velocity; 0: only the position makes an event, m/s")
    ] = 0.0
    repeats: Annotated[int, Meta(ge=1, le=16, description="r, ticks in a row in which an event is sent")] = 1
    forget_s: Annotated[
        float,
        Meta(gt=0, description="with a broadcast every tick: who was not received for so long is not reckoned with, s"),
    ] = 5.0
