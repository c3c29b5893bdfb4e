"""Tables of states that are shared, and of the filter that uses them."""

from typing import Annotated, Any, Literal, NamedTuple

from msgspec import field

from meanflock.swarm.scenario.described import OURS, key
from meanflock.swarm.toml import Table as _Table


class SharingRule(NamedTuple):
    """Rule by which a UAV broadcasts its state.

    broadcast: every tick, or at events. delta_m: error of the predicted position that makes an event, m.
    velocity_delta_m_s: the same for the velocity; 0: the velocity makes no events, m/s. repeats: number of consecutive
    ticks in which an event is sent.
    """

    broadcast: Literal["tick", "event"]
    delta_m: float
    velocity_delta_m_s: float
    repeats: int


POLICIES = {
    "tick": SharingRule("tick", 0.3, 0.0, 1),
    "event": SharingRule("event", 0.3, 0.0, 1),
    "event-4": SharingRule("event", 0.3, 0.2, 4),
}


class Sharing(_Table, frozen=True):
    """Broadcasts of states by controllers that share states, and by filters."""

    policy: Annotated[
        Literal["tick", "event", "event-4"],
        key(
            "`tick`: every tick; `event`: if others predict the position too badly; `event-4`: or the velocity, and "
            "four times. Each of the keys below changes one part of it",
            OURS,
            "collision-free also if a third of the messages is lost, with a tenth of the bits sent by `tick`",
        ),
    ] = "event-4"
    broadcast: (
        Annotated[
            Literal["tick", "event"],
            key(
                "`tick`: four floats every tick; `event`: 64 bits if others predict the state too badly; unset: the "
                "policy's",
                OURS,
                "",
            ),
        ]
        | None
    ) = None
    delta_m: (
        Annotated[
            float,
            key(
                "δ, error of the position that others predict above which an event is sent; unset: the policy's",
                OURS,
                "below half of the distance that a filter maintains",
                unit="m",
                gt=0,
            ),
        ]
        | None
    ) = None
    velocity_delta_m_s: (
        Annotated[
            float,
            key(
                "the same for the velocity; 0: only the position causes an event; unset: the policy's",
                OURS,
                "",
                unit="m/s",
                ge=0,
            ),
        ]
        | None
    ) = None
    repeats: (
        Annotated[
            int,
            key(
                "r, number of consecutive ticks in which an event is sent; unset: the policy's",
                OURS,
                "enough if a third of the messages is lost",
                unit="ticks",
                ge=1,
                le=16,
            ),
        ]
        | None
    ) = None
    forget_s: Annotated[
        float,
        key(
            "with a broadcast every tick: a UAV that was not received for this long is ignored",
            OURS,
            "longer than a series of losses, shorter than a flight across the formation",
            unit="s",
            gt=0,
        ),
    ] = 5.0

    @property
    def rule(self) -> SharingRule:
        """The policy, changed by the keys that are set."""
        changes = {key: value for key in SharingRule._fields if (value := getattr(self, key)) is not None}
        return POLICIES[self.policy]._replace(**changes)


class FilterTable(_Table, frozen=True):
    """Filter that may change the accelerations of any controller."""

    kind: Annotated[
        str,
        key(
            "the filter, see `meanflock plugins`; `none`: commands are flown as the controller gives them",
            OURS,
            "the paper has no collision avoidance",
        ),
    ] = "none"
    options: Annotated[dict[str, Any], key("options of that filter", OURS, "a filter declares its own")] = field(
        default_factory=dict
    )
