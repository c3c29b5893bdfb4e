"""Every column of `timeseries.parquet`: name, type, unit and meaning.

The schema of the file, the metadata of its columns and docs/data.md are made of this.
A row is a tick, the first that of take-off. A column of lists has an entry a UAV.
"""

from collections.abc import Iterable
from typing import NamedTuple

import pyarrow as pa

from meanflock.groundstation import quantities
from meanflock.swarm.errors import BadInput
from meanflock.swarm.wire.messages import SWARM_COLUMNS, Status

STATUS = {int(status): status.name.lower() for status in Status}
_NUMBER, _EACH, _STATE = pa.float64(), pa.list_(pa.float32()), pa.list_(pa.float64())
_BITS = "payload sent by {}, once a transmission"


class Column(NamedTuple):
    """unit: `1` for a number without one, empty for what has none. cumulative: counted or averaged since take-off."""

    name: str
    type: pa.DataType
    unit: str
    about: str
    cumulative: bool = False

    @property
    def field(self) -> pa.Field:
        """The column as Arrow has it, with what is to be known of it as metadata."""
        metadata = {"description": self.about, "unit": self.unit, "cumulative": str(self.cumulative).lower()}
        if self.name == "status":
            metadata["values"] = status_names()
        return pa.field(self.name, self.type, metadata=metadata)


BEFORE = (
    Column("tick", pa.int32(), "ticks", "number of the tick"),
    Column("sim_time_s", _NUMBER, "s", "simulated time since take-off"),
    Column("x_m", _STATE, "m", "position of each UAV, from the origin"),
    Column("y_m", _STATE, "m", "position of each UAV, from the origin"),
    Column("vx_m_s", _STATE, "m/s", "velocity of each UAV, over ground"),
    Column("vy_m_s", _STATE, "m/s", "velocity of each UAV, over ground"),
    Column("ax_m_s2", _EACH, "m/s²", "commanded acceleration of each UAV in the tick that led here"),
    Column("ay_m_s2", _EACH, "m/s²", "commanded acceleration of each UAV in the tick that led here"),
    Column("energy_J", _EACH, "J", "energy each UAV has used, past its arrival too", True),
)  # here the diagnostics of the controller follow
_OF_SWARM = (
    Column("uplink_bits", _NUMBER, "bit", _BITS.format("UAVs that upload their model"), True),
    Column("relay_bits", _NUMBER, "bit", _BITS.format("heads of clusters to the leader"), True),
    Column("broadcast_bits", _NUMBER, "bit", _BITS.format("the leader with the global model"), True),
    Column("state_bits", _NUMBER, "bit", _BITS.format("controllers, own states as a rule"), True),
    Column("deliveries", _NUMBER, "messages", "messages delivered over links, a broadcast once a receiver", True),
    Column("outages", _NUMBER, "messages", "messages given up on links, a broadcast once a receiver", True),
    Column(
        "airtime_s", _NUMBER, "s", "time transmissions took; each lasts until its last link is served or given up", True
    ),
    Column("phi_A", _NUMBER, "m/s", "alignment φ_A: mean difference of velocities, lower is better", True),
    Column("phi_C", _NUMBER, "1", "collision risk φ_C as printed, with self-pairs", True),
    Column(
        "phi_C_distinct",
        _NUMBER,
        "1",
        "collision risk φ_C: share of distinct pairs nearer than r_C; 0 of a single UAV",
        True,
    ),
    Column(
        "collisions",
        _NUMBER,
        "pairs",
        "pairs that came nearer than r_coll in a tick that both began on the way, each once",
        True,
    ),
    Column("arrived", _NUMBER, "UAVs", "UAVs that have arrived"),
    Column("round", _NUMBER, "1", "rounds averaged and broadcast", True),
    Column("held_commands", _NUMBER, "commands", "commands held over because they came late, in real time", True),
    Column("deadline_misses", _NUMBER, "ticks", "ticks in which any command came late, in real time", True),
)
AFTER = (
    Column("status", pa.list_(pa.uint8()), "", "state of the mission of each UAV"),
    *_OF_SWARM,
    Column(
        "weight_spread", _NUMBER, "1", "RMS distance of what the UAVs have learned from its mean; null between reports"
    ),
    Column(
        "leader_model",
        _EACH,
        "1",
        "what the leader's UAV has learned, as its controller reports it; null between reports",
    ),
)
RESERVED = frozenset(column.name for column in (*BEFORE, *AFTER))
assert tuple(column.name for column in _OF_SWARM) == SWARM_COLUMNS


def diagnostic(name: str) -> Column:
    """The column of a diagnostic; of one that only its controller knows, only the name is known here."""
    known = quantities.of(name)
    about = f"{known.name} of each UAV" if known.name != name else f"what the controller reports as {name}, of each UAV"
    return Column(name, _EACH, known.unit, f"{about}, in the tick that led here; 0 at take-off")


def columns(diagnostics: Iterable[str]) -> tuple[Column, ...]:
    """All columns of a run whose controller reports these diagnostics."""
    return (*BEFORE, *map(diagnostic, diagnostics), *AFTER)


def status_names() -> str:
    """The numbers of a status and their names."""
    return ", ".join(f"{number} {name}" for number, name in STATUS.items())


def check(controller: str, diagnostics: Iterable[str]) -> None:
    """Lets diagnostics through that can be columns.

    Raises:
        BadInput: one is called as another column is.
    """
    if taken := sorted(RESERVED & set(diagnostics)):
        raise BadInput(
            f"controller {controller!r}: `diagnostics` {', '.join(taken)}: the time series has columns of that name; "
            "give it another"
        )
