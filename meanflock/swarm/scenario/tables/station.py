"""Table of a station: a node of the radio that does not fly."""

from typing import Annotated

from msgspec import Meta

from meanflock.swarm.scenario.tables.radios import OwnRadio

MOST_STATIONS = 16


class Station(OwnRadio, frozen=True, omit_defaults=True, kw_only=True):
    """A station: it sends and receives, and does not fly, learn or count in any metric of the flight."""

    place: Annotated[
        tuple[float, float, Annotated[float, Meta(ge=0)]], Meta(description="where its antenna is, height last, m")
    ]
    bandwidth_hz: (
        Annotated[
            float, Meta(ge=1, le=1e15, description="bandwidth in which it sends, Hz; unset: `radio.bandwidth_hz`")
        ]
        | None
    ) = None

    @property
    def differs(self) -> bool:
        return super().differs or self.bandwidth_hz is not None
