"""A scenario: every number a run depends on, with its unit, its bounds and the paper's value as default."""

from meanflock.swarm.scenario.described import OURS, PRINTED, SILENT, Key, keys_of  # noqa: F401
from meanflock.swarm.scenario.scenario import (  # noqa: F401
    Scenario,
    decode,
    encode,
    load,
    read_faults,
    schema,
    with_defaults,
)
from meanflock.swarm.scenario.tables import (  # noqa: F401
    Destination,
    Energy,
    Federation,
    FilterTable,
    GroupTable,
    Metrics,
    Obstacle,
    Radio,
    Sharing,
    Space,
    Start,
    Station,
    Truth,
    VehicleTable,
    Wind,
)
from meanflock.swarm.scenario.until import Until  # noqa: F401
from meanflock.swarm.scenario.values import as_builtins, toml_text, validated  # noqa: F401
