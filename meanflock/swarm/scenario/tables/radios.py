"""Table of the radios that differ from `[radio]`."""

from typing import Annotated

from msgspec import Meta

from meanflock.swarm.toml import Table as _Table


class UnequalRadio(_Table, frozen=True, omit_defaults=True):
    """The radio of some UAVs, where it differs from that of the others. No UAV is named twice."""

    uavs: Annotated[
        tuple[Annotated[int, Meta(ge=0)], ...], Meta(min_length=1, description="the UAVs that have such a radio")
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

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.tx_power_dbm is None and self.gain_dbi is None and self.noise_figure_db is None:
            raise ValueError(
                "a radio of `[[radios]]` differs in `tx_power_dbm`, `gain_dbi` or `noise_figure_db`: set one"
            )
