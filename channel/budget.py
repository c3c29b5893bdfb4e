"""Options of a link budget, and the path losses and laws of fading that they choose."""

from functools import partial
from typing import Annotated, Literal

from msgspec import Meta

from meanflock.channel.base import Channel
from meanflock.channel.gains import RAYLEIGH, STEADY, Gain, nakagami, rice, rice_by_elevation
from meanflock.channel.losses.al_hourani import ENVIRONMENTS, al_hourani
from meanflock.channel.losses.model import Model
from meanflock.channel.losses.models import MODELS
from meanflock.channel.losses.plain import log_distance
from meanflock.swarm.errors import BadInput

AnyLoss = Literal[
    "free-space", "log-distance", "two-ray", "uma", "umi", "rma", "uma-av", "umi-av", "rma-av", "al-hourani"
]
Positive = Annotated[float, Meta(gt=0)]
NotNegative = Annotated[float, Meta(ge=0)]
AirLoss = Literal["free-space", "log-distance", "two-ray", "air-to-air"]


class Options(Channel.Options, frozen=True):
    """Keys of `[radio.options]`. Those with `air_` are of links between UAVs, those without of links to stations."""

    carrier_ghz: Annotated[float, Meta(gt=0, description="f, carrier, GHz")] = 2.4
    gain_dbi: Annotated[float, Meta(description="gain of each antenna, dBi")] = 0.0
    noise_figure_db: Annotated[float, Meta(ge=0, description="noise figure of the receivers, dB")] = 7.0
    rate: Annotated[
        Literal["cqi", "shannon"],
        Meta(description="rate and SNR of a slot: `cqi` of 3GPP's table, `shannon` log₂(1 + η/gap)"),
    ] = "cqi"
    cqi: Annotated[int, Meta(ge=1, le=15, description="row of the CQI table; with rate = cqi")] = 7
    gap_db: Annotated[float, Meta(ge=0, description="gap to Shannon's limit, dB; with rate = shannon")] = 0.0
    loss: Annotated[AnyLoss | None, Meta(description="path loss to stations; unset: air_loss")] = None
    air_loss: Annotated[AirLoss, Meta(description="path loss between UAVs")] = "free-space"
    exponent: Annotated[float, Meta(ge=0, description="n of log-distance, 1")] = 2.0
    reference_db: Annotated[float | None, Meta(description="loss of log-distance at 1 m, dB; unset: free space")] = None
    environment: Annotated[
        Literal["suburban", "urban", "dense-urban", "highrise"], Meta(description="town of al-hourani")
    ] = "urban"
    a: Annotated[Positive | None, Meta(description="a of al-hourani, °; unset: of the environment")] = None
    b: Annotated[Positive | None, Meta(description="b of al-hourani, 1/°; likewise")] = None
    eta_los_db: Annotated[float | None, Meta(description="excess loss in sight, dB; likewise")] = None
    eta_nlos_db: Annotated[float | None, Meta(description="excess loss without sight, dB; likewise")] = None
    sigma_db: Annotated[NotNegative | None, Meta(description="σ of the shadow, dB; unset: of the loss")] = None
    air_sigma_db: Annotated[NotNegative | None, Meta(description="the same between UAVs, dB")] = None
    correlation_m: Annotated[
        Positive | None,
        Meta(description="distance at which a shadow's correlation is 1/e, m; unset: of the loss"),
    ] = None
    fading: Annotated[
        Literal["none", "rayleigh", "rice", "rice-elevation", "nakagami"],
        Meta(description="fading in sight; without sight it is Rayleigh's"),
    ] = "rice"
    air_fading: Annotated[
        Literal["none", "rayleigh", "rice", "nakagami"], Meta(description="the same between UAVs")
    ] = "rice"
    k_db: Annotated[float, Meta(ge=-40, le=20, description="K of rice, dB")] = 15.0
    air_k_db: Annotated[float, Meta(ge=-40, le=20, description="the same between UAVs, dB")] = 12.0
    k_horizon_db: Annotated[float, Meta(ge=-40, le=20, description="K of rice-elevation at 0°, dB")] = 5.0
    k_zenith_db: Annotated[float, Meta(ge=-40, le=20, description="K of rice-elevation at 90°, dB")] = 15.0
    m: Annotated[float, Meta(ge=0.5, le=50, description="m of nakagami, 1")] = 2.0
    air_m: Annotated[float, Meta(ge=0.5, le=50, description="the same between UAVs, 1")] = 2.0


def model_of(name: str, options: Options) -> Model:
    """The path loss of that name with its options."""
    model = MODELS[name]
    if name == "log-distance":
        return model._replace(
            losses=partial(log_distance, exponent=options.exponent, reference_db=options.reference_db)
        )
    if name == "al-hourani":
        town = ENVIRONMENTS[options.environment]
        given = {key: getattr(options, key) for key in town._fields if getattr(options, key) is not None}
        return model._replace(losses=partial(al_hourani, environment=town._replace(**given)))
    return model


def laws_of(fading: str, k_db: float, m: float, options: Options) -> list[Gain]:
    """The law of fading without sight, and then those in sight."""
    if fading == "none":
        return [STEADY, STEADY]
    if fading == "rayleigh":
        return [RAYLEIGH, RAYLEIGH]
    if fading == "rice":
        return [RAYLEIGH, rice(k_db)]
    if fading == "nakagami":
        return [RAYLEIGH, nakagami(m)]
    return [RAYLEIGH, *rice_by_elevation(options.k_horizon_db, options.k_zenith_db)]


def check_effects(options: Options, stations: int) -> None:
    """Raises BadInput if a key is set that has no effect beside the others."""
    losses = (options.air_loss, options.loss)
    switches = [
        ("rate = 'cqi'", options.rate == "cqi", ("cqi",)),
        ("rate = 'shannon'", options.rate == "shannon", ("gap_db",)),
        ("a path loss 'log-distance'", "log-distance" in losses, ("exponent", "reference_db")),
        ("loss = 'al-hourani'", "al-hourani" in losses, ("environment", "a", "b", "eta_los_db", "eta_nlos_db")),
        ("[[stations]]", stations > 0, ("loss", "sigma_db", "fading")),
        ("[[stations]] and fading = 'rice'", stations > 0 and options.fading == "rice", ("k_db",)),
        ("fading = 'rice-elevation'", options.fading == "rice-elevation", ("k_horizon_db", "k_zenith_db")),
        ("fading = 'nakagami'", options.fading == "nakagami", ("m",)),
        ("air_fading = 'rice'", options.air_fading == "rice", ("air_k_db",)),
        ("air_fading = 'nakagami'", options.air_fading == "nakagami", ("air_m",)),
    ]
    default = Options()
    for switch, is_on, keys in switches:
        for key in keys:
            if not is_on and getattr(options, key) != getattr(default, key):
                raise BadInput(
                    f"radio.options.{key} has no effect without {switch}: add that, or leave the key out. Keys with "
                    "air_ are of links between UAVs, the others of links to stations"
                )
    if stations and losses == ("air-to-air", None):
        raise BadInput("radio.options.air_loss = 'air-to-air' is of UAVs only; set radio.options.loss for the stations")
