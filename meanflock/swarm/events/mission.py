"""Events of the UAVs in the air: arrivals, encounters, faults and steering."""

from meanflock.swarm.events.base import BaseEvent, Count, Uavs, listed


class CommandsIgnored(BaseEvent, frozen=True):
    """The vehicle moves without regard to commands."""

    meanings = {"uncommanded": "the flight begins with a vehicle whose motion does not depend on commands"}
    level = "WARN"
    model: str
    method: str

    @property
    def text(self) -> str:
        return f"the commands of {self.method} have no effect: the vehicle {self.model} replays recorded movement"


class Arrived(BaseEvent, frozen=True):
    """UAVs reached the destination."""

    meanings = {"arrived": "UAVs arrived"}
    uavs: Uavs

    @property
    def text(self) -> str:
        return f"{listed(self.uavs)} arrived"


class Landed(BaseEvent, frozen=True):
    """UAVs landed where they were, for good."""

    meanings = {"landed": "UAVs landed for good, where they were: their group leaves, or their battery is empty"}
    level = "WARN"
    uavs: Uavs
    reason: str

    @property
    def text(self) -> str:
        return f"{listed(self.uavs)} landed: {self.reason}"


class TurnedBack(BaseEvent, frozen=True):
    """UAVs have a low battery, and return."""

    meanings = {"low": "UAVs have a low battery, and fly to the nearest landing place"}
    level = "WARN"
    uavs: Uavs

    @property
    def text(self) -> str:
        return f"{listed(self.uavs)} turned back: low battery"


class Joined(BaseEvent, frozen=True):
    """UAVs of a group take off, after others."""

    meanings = {"takeoff": "a group of UAVs joins the flight"}
    uavs: Uavs
    group: str

    @property
    def text(self) -> str:
        return f"{listed(self.uavs)} of group {self.group} joined"


class Collided(BaseEvent, frozen=True):
    """Two UAVs collided."""

    meanings = {"collision": "two UAVs came nearer than r_coll in this tick, and both were on the way at its start"}
    level = "ERROR"
    first: Count
    second: Count

    @property
    def text(self) -> str:
        return f"UAV {self.first} and UAV {self.second} collided"

    @property
    def uavs(self) -> Uavs:
        return self.first, self.second


class HitObstacle(BaseEvent, frozen=True):
    """A UAV entered an obstacle. disc: its number in the scenario, from 0."""

    meanings = {"hit": "a UAV entered one of `[[obstacles]]` for the first time, in this tick"}
    level = "ERROR"
    uav: Count
    disc: Count

    @property
    def text(self) -> str:
        return f"UAV {self.uav} hit obstacle {self.disc}"

    @property
    def uavs(self) -> Uavs:
        return (self.uav,)


class Grounded(BaseEvent, frozen=True):
    """A UAV came down to the ground."""

    meanings = {
        "grounded": "in space, a UAV came down to the ground for the first time, after take-off and not arrived"
    }
    level = "ERROR"
    uav: Count

    @property
    def text(self) -> str:
        return f"UAV {self.uav} hit the ground"

    @property
    def uavs(self) -> Uavs:
        return (self.uav,)


class LeftAltitudes(BaseEvent, frozen=True):
    """A UAV went below the floor or above the ceiling. limit_m: the limit."""

    meanings = {
        "altitude": "in space, a UAV went below `space.floor` or above `space.ceiling` for the first time, in this tick"
    }
    level = "ERROR"
    uav: Count
    is_floor: bool
    limit_m: float

    @property
    def text(self) -> str:
        side = "below the floor" if self.is_floor else "above the ceiling"
        return f"UAV {self.uav} went {side} of {self.limit_m:g} m"

    @property
    def uavs(self) -> Uavs:
        return (self.uav,)


class LinksClamped(BaseEvent, frozen=True):
    """Links lead where the path loss of the channel does not hold."""

    meanings = {"clamped": "links, for the first time, lead where the source of the path loss does not hold"}
    level = "WARN"
    links: Count

    @property
    def text(self) -> str:
        return (
            f"{self.links} links are shorter, longer, lower or higher than their path loss holds for, and count as its "
            "nearest; `radio.clamped` counts such links"
        )


class DutyExceeded(BaseEvent, frozen=True):
    """Radios send for a larger share of the time than they may.

    Attributes:
        nodes: the names of these that had not before.
    """

    meanings = {"duty": "radios, for the first time, have sent for a larger share of the time than `radio.duty_max`"}
    level = "WARN"
    nodes: tuple[str, ...]
    limit: float

    @property
    def text(self) -> str:
        return f"the radio of {', '.join(self.nodes)} has sent for more than {100 * self.limit:g} % of the time"


class Lost(BaseEvent, frozen=True):
    """UAVs are lost with their node."""

    meanings = {"lost": "UAVs are lost with their node"}
    level = "ERROR"
    uavs: Uavs
    reason: str

    @property
    def text(self) -> str:
        return f"{self.reason}: {listed(self.uavs)} lost"


class Diverged(BaseEvent, frozen=True):
    """UAVs are lost because of their numbers."""

    meanings = {"diverged": "UAVs are lost because their numbers are not finite or their controller failed"}
    level = "ERROR"
    uavs: Uavs
    reason: str

    @property
    def text(self) -> str:
        return f"{self.reason}: {listed(self.uavs)} lost"


class Rejoined(BaseEvent, frozen=True):
    """A new agent flies lost UAVs."""

    meanings = {"rejoined": "lost UAVs have an agent again"}
    uavs: Uavs
    node: str

    @property
    def text(self) -> str:
        return f"{self.node} rejoined with {listed(self.uavs)}"


class StatesRefused(BaseEvent, frozen=True):
    """UAVs sent states that no UAV can have."""

    meanings = {"refused": "states of UAVs were not believed; each UAV is named once, the summary counts all"}
    uavs: Uavs

    @property
    def text(self) -> str:
        return f"states of {listed(self.uavs)} were not believed: no UAV can be so"


class SteeringBegan(BaseEvent, frozen=True):
    """A client steers a UAV. client: its address."""

    meanings = {"steered": "a client of `--steer` commands a UAV in place of its controller"}
    uav: Count
    client: str

    @property
    def text(self) -> str:
        return f"UAV {self.uav} is steered by {self.client}, not by its controller"

    @property
    def uavs(self) -> Uavs:
        return (self.uav,)


class SteeringEnded(BaseEvent, frozen=True):
    """A UAV is given back to its controller."""

    meanings = {"released": "the client was silent, and the UAV flies by its controller again"}
    uav: Count

    @property
    def text(self) -> str:
        return f"UAV {self.uav} flies by its controller again"

    @property
    def uavs(self) -> Uavs:
        return (self.uav,)


class FaultBegan(BaseEvent, frozen=True):
    """A fault of the script begins. number: its place in the script, from 0. fault: the fault in words."""

    meanings = {"fault": "a fault of the script begins"}
    uavs: Uavs
    number: Count
    fault: str

    @property
    def text(self) -> str:
        return self.fault


class FaultEnded(BaseEvent, frozen=True):
    """A fault of the script ends; the fields are those of `FaultBegan`."""

    meanings = {"fault": "a fault of the script ends"}
    uavs: Uavs
    number: Count
    fault: str

    @property
    def text(self) -> str:
        return f"{self.fault} is over"


class FaultNeverBegins(BaseEvent, frozen=True):
    """The flight ends before a fault of the script begins. begins_s: when it would, s. duration_s: of the flight, s."""

    meanings = {"fault": "a fault of the script begins after the end of the longest flight"}
    number: Count
    fault: str
    begins_s: float
    duration_s: float

    @property
    def text(self) -> str:
        return f"{self.fault} never happens: it begins at {self.begins_s:g} s, and `duration` is {self.duration_s:g} s"
