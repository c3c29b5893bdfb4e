"""A scenario: every number a run depends on, with its unit, its bounds and the paper's value as default."""

from meanflock.swarm.scenario.files import decode, encode, from_table, load, read_faults, schema, to_table
from meanflock.swarm.scenario.scenario import LATER, Scenario
from meanflock.swarm.scenario.tables import (
    Cost,
    Density,
    Destination,
    Federation,
    Filter,
    Learner,
    Metrics,
    Obstacle,
    Offline,
    Payload,
    Radio,
    Start,
    Truth,
    Vehicle,
    Wind,
)

__all__ = [
    "LATER",
    "Cost",
    "Density",
    "Destination",
    "Federation",
    "Filter",
    "Learner",
    "Metrics",
    "Obstacle",
    "Offline",
    "Payload",
    "Radio",
    "Scenario",
    "Start",
    "Truth",
    "Vehicle",
    "Wind",
    "decode",
    "encode",
    "from_table",
    "load",
    "read_faults",
    "schema",
    "to_table",
]
