"""Tables of radios that differ from `[radio]`."""

from typing import Annotated

from msgspec import Meta

from meanflock.swarm.toml import Table as _Table


class OwnRadio(_Table, frozen=True, omit_defaults=True, kw_only=True):
    """Power, gain and noise figure of the radio of a node, where they differ from those of the other nodes."""

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

    @property
    def differs(self) -> bool:
        """Returns whether anything of it is set."""
        return any(value is not None for value in (self.tx_power_dbm, self.gain_dbi, self.noise_figure_db))


class UnequalRadio(OwnRadio, frozen=True, omit_defaults=True, kw_only=True):
    """The radio of some UAVs, where it differs from that of the others. No UAV is named twice."""

    uavs: Annotated[
        tuple[Annotated[int, Meta(ge=0)], ...], Meta(description="the UAVs that have such a radio; unset: see `group`")
    ] = ()
    group: Annotated[str, Meta(description="name of the group whose UAVs have it, instead of `uavs`")] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if bool(self.uavs) == (self.group is not None):
            raise ValueError("a radio of `[[radios]]` is that of some `uavs`, or of a `group`: set one of the two")
        if not self.differs:
            raise ValueError(
                "a radio of `[[radios]]` differs in `tx_power_dbm`, `gain_dbi` or `noise_figure_db`: set one"
            )
