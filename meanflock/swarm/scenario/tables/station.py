"""Table of a station: a node of the radio that does not fly."""

from typing import Annotated

from msgspec import Meta

from meanflock.swarm.toml import Table as _Table

MOST_STATIONS = 16


class Station(_Table, frozen=True, omit_defaults=True):
    """A station: it sends and receives, and does not fly, learn or count in any metric of the flight."""

    place: Annotated[
        tuple[float, float, Annotated[float, Meta(ge=0)]], Meta(description="where its antenna is, height last, m")
    ]
    tx_power_dbm: (
        Annotated[float, Meta(ge=-300, le=300, description="its power, dBm; unset: `radio.tx_power_dbm`")] | None
    ) = None
    gain_dbi: (
        Annotated[
            float, Meta(ge=-100, le=100, description="gain of its antenna, dBi; unset: that of `[radio.options]`")
        ]
        | None
    ) = None
    noise_figure_db: (
        Annotated[
            float, Meta(ge=0, le=100, description="noise figure of its receiver, dB; unset: that of `[radio.options]`")
        ]
        | None
    ) = None
    bandwidth_hz: (
        Annotated[
            float,
            Meta(ge=1, le=1e15, description="bandwidth in which it sends, Hz; unset: `radio.bandwidth_hz`"),
        ]
        | None
    ) = None

    @property
    def has_own_radio(self) -> bool:
        """Returns whether it differs from the radio of the UAVs in more than its place."""
        return any(
            value is not None for value in (self.tx_power_dbm, self.gain_dbi, self.noise_figure_db, self.bandwidth_hz)
        )
