"""The tables of a scenario: every number with its unit, its bounds and the paper's value as default."""

from meanflock.swarm.scenario.tables.federation import Federation  # noqa: F401
from meanflock.swarm.scenario.tables.group import MOST_UAVS, GroupTable  # noqa: F401
from meanflock.swarm.scenario.tables.mission import Destination, Metrics, Obstacle, Start, Truth, Wind  # noqa: F401
from meanflock.swarm.scenario.tables.pace import Pace  # noqa: F401
from meanflock.swarm.scenario.tables.radio import Radio  # noqa: F401
from meanflock.swarm.scenario.tables.radios import UnequalRadio  # noqa: F401
from meanflock.swarm.scenario.tables.sharing import POLICIES, FilterTable, Sharing, SharingRule  # noqa: F401
from meanflock.swarm.scenario.tables.space import Space  # noqa: F401
from meanflock.swarm.scenario.tables.station import MOST_STATIONS, Station  # noqa: F401
from meanflock.swarm.scenario.tables.training import Training  # noqa: F401
from meanflock.swarm.scenario.tables.vehicle import Energy, VehicleTable  # noqa: F401
