"""Table of the radio."""

import math
from typing import Annotated, Any, Literal

from msgspec import field

from meanflock.swarm.scenario.described import OURS, PRINTED, SILENT, key
from meanflock.swarm.toml import Table as _Table


class Radio(_Table, frozen=True):
    """The Rician FDMA link and its accounting."""

    tx_power_dbm: Annotated[float, key("P_o, power of a transmitter", PRINTED, "", unit="dBm", ge=-300, le=300)] = 20.0
    bandwidth_hz: Annotated[
        float, key("W_o, bandwidth of a link", PRINTED, "", unit="Hz", ge=1, le=1000000000000000.0)
    ] = 2e6
    noise_psd_dbm_hz: Annotated[
        float, key("σ_n, power density of the noise", PRINTED, "", unit="dBm/Hz", ge=-300, le=300)
    ] = -110.0
    path_loss_exponent: Annotated[
        float,
        key(
            "α, exponent of the path loss",
            PRINTED,
            "with α = 0 all links are alike, whatever their length. The paper's equations ask for α ≥ 2, its list of "
            "parameters has 0",
            ge=0,
        ),
    ] = 0.0
    rice_xi: Annotated[float, key("ξ, strength of the line of sight", PRINTED, "", ge=0)] = 6.649
    rice_chi: Annotated[float, key("χ, strength of the scattered paths", PRINTED, "", gt=0)] = 1.347
    fading: Annotated[
        Literal["amplitude", "power"],
        key(
            "SNR ∝ z, as printed, or ∝ z²", PRINTED, "the paper multiplies the SNR by an amplitude; `power` squares it"
        ),
    ] = "amplitude"
    target_snr_db: Annotated[
        float,
        key(
            "η, SNR below which a slot carries nothing",
            SILENT,
            "printed power, noise and fading give a median SNR of 75.3 dB at every distance, because α = 0; with a "
            "target near this median the radio loses long models sometimes and short ones rarely",
            unit="dB",
            ge=-300,
            le=300,
        ),
    ] = 75.0
    coherence_time_s: Annotated[
        float,
        key("θ, length of a slot", SILENT, "chosen together with `radio.target_snr_db`", unit="s", ge=1e-09, le=1000.0),
    ] = 5e-5
    latency_threshold_slots: Annotated[
        int, key("D_M, slots after which a message is lost", SILENT, "likewise", unit="slots", ge=1, le=1000000)
    ] = 8
    bits_per_float: Annotated[
        Literal[16, 32, 64],
        key("width of a float on the radio", SILENT, "b in the paper's formula of the payload", unit="bit"),
    ] = 32
    range_m: Annotated[
        float,
        key(
            "distance that a broadcast of a UAV reaches",
            PRINTED,
            "the reach of the states that `hjb` sends",
            unit="m",
            gt=0,
        ),
    ] = 100.0
    access: Annotated[
        Literal["fdma", "tdma", "csma"],
        key(
            "how transmissions share the spectrum: a band for each link, or one band, in turns or by contention",
            PRINTED,
            "with `fdma` no link waits, and a UAV needs a receiver for each UAV that it hears. With `tdma` "
            "transmissions wait for one another; airtime and losses are the same. With `csma` they collide, too: see "
            "[channels](channels.md#who-waits-for-whom)",
            later=True,
        ),
    ] = "fdma"
    bands: Annotated[
        Literal["one", "cluster"],
        key(
            "bands of `tdma`: one for all UAVs, or one for each cluster and one for heads and leader",
            OURS,
            "in one band a UAV needs one receiver, in several it needs more",
            later=True,
        ),
    ] = "one"
    contention_slot_s: Annotated[
        float,
        key(
            "σ, slot in which UAVs count their backoff with `csma`",
            OURS,
            "of IEEE 802.11b; 9 µs in 802.11a. At most half of `radio.coherence_time_s`",
            unit="s",
            later=True,
            gt=0,
            le=1.0,
        ),
    ] = 2e-5
    duty_max: (
        Annotated[
            float,
            key(
                "share of the time that a radio may send; a round that needs more is refused, and an event names who "
                "sends more in flight; unset: no limit",
                OURS,
                "the paper has none; 0.01 is usual at 868 MHz in Europe",
                later=True,
                gt=0,
                le=1,
            ),
        ]
        | None
    ) = None
    plausible_speed: Annotated[
        float,
        key(
            "received states that are faster, or farther away than this speed allows, are not used",
            OURS,
            "far above the speeds flown here; [robustness](robustness.md#false-states) measures false states below it",
            unit="m/s",
            later=True,
            gt=0,
        ),
    ] = 100.0
    model: Annotated[str, key("the channel, see `meanflock plugins`", PRINTED, "", later=True)] = "rice"
    options: Annotated[
        dict[str, Any], key("options of that channel", OURS, "a channel declares its own", later=True)
    ] = field(default_factory=dict)

    @property
    def contention_slots(self) -> float:
        """σ/θ, the contention slot in slots."""
        return self.contention_slot_s / self.coherence_time_s

    @property
    def bits_per_slot(self) -> float:
        """θ W_o log₂(1 + η): what a slot carries if its SNR reaches the target."""
        return self.coherence_time_s * self.bandwidth_hz * math.log2(1.0 + 10.0 ** (self.target_snr_db / 10.0))
