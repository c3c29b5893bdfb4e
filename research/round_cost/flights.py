"""The cells of the study, the shortest period of each, and one flight of it, measured."""

import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import msgspec
import numpy as np

from meanflock.federation.plan import plan_of
from meanflock.launch.engine import Engine
from meanflock.studies import published
from meanflock.studies.lent_radio import lent_radio
from meanflock.swarm import plugins, scenario
from meanflock.swarm.errors import BadInput
from meanflock.swarm.scenario import Scenario
from meanflock.worldsim.tick import Row

ROOT = published.DOCS.parent
PLUGIN = ROOT / "examples" / "classifier.py"
FIRST_SEED = 93001  # no other study uses these seeds
SEEDS = 4  # of each cell; on a radio that loses slots, whose flights differ more, twice as many
LEARNING_S = 120.0  # time in which the classifier learns
# Two radios more, that of the paper with slots of 60 ms and less noise: a model needs 4 good slots of at most 8.
LOSSY = {"20 % of slots lost": "-88.61", "36 % of slots lost": "-88.13"}  # name → noise, dBm/Hz
MAST = ("stations=[{place=[0.0, 0.0, 25.0]}]",)  # of radios whose scenario has none
# Power of a radio that sends and one that receives: 380 and 313 mA at 3 V.
POWER = ("energy.radio_W=1.14", "energy.receive_W=0.94")
WAYS: dict[str, tuple[str, ...]] = {
    "leader": (),
    "clusters": ("federation.clusters=5",),
    "neighbours": ('federation.topology="neighbours"',),
    "station": ("federation.station=0",),
}
OWN, SHARED, CONTENTION, CLUSTER = "fdma", "tdma", "csma", "tdma, a band a cluster"
ACCESS: dict[str, tuple[str, ...]] = {
    **{name: (f'radio.access="{name}"',) for name in (OWN, SHARED, CONTENTION)},
    CLUSTER: ('radio.access="tdma"', 'radio.bands="cluster"'),
}
METHODS = ("classifier", "fed-lspi")
TRAINING_TICKS = 10  # in which the classifier trains before each round, a step of SGD a tick
PERIOD_TICKS = 20  # between rounds of `fed-lspi`, where a round is no longer


class Cell(NamedTuple):
    """A cell of the study: what learns, on which radio, how it averages, and how transmissions share the spectrum."""

    method: str
    radio: str
    way: str
    access: str


def radios() -> dict[str, tuple[str, ...]]:
    """Settings of each radio, with its stations; where the leader averages is up to the way."""
    load_classifier()
    found = {}
    for name in ("radio-sky", "radio-mast", "radio-street", "radio-thin"):
        lent = lent_radio(ROOT / "scenarios" / f"{name}.toml").settings
        own = tuple(one for one in lent if not one.startswith("federation.station="))
        found[name] = own if any(one.startswith("stations=") for one in own) else own + MAST
    found["radio-thin"] += ("radio.duty_max=1.0",)  # its limit of 1 % would rule, in place of the ways
    for name, noise in LOSSY.items():
        slots = "radio.coherence_time_s=0.06", "radio.bandwidth_hz=13e3", f"radio.noise_psd_dbm_hz={noise}"
        found[name] = *slots, *MAST
    return found


def load_classifier() -> None:
    """Make the controller of examples/classifier.py known."""
    if "classifier" not in plugins.names("controller"):
        plugins.load_files([PLUGIN])


def cells() -> list[Cell]:
    """Every cell, in the order of the tables.

    Between UAVs `radio-mast` and `radio-street` lose as little as `radio-sky`, so only the way by the station is flown.
    """
    return [
        Cell(method, radio, way, access)
        for method in METHODS
        for radio in radios()
        for way in WAYS
        if way == "station" or radio not in ("radio-mast", "radio-street")
        for access in ACCESS
        if access != CLUSTER or (way, method) == ("clusters", "classifier")
    ]


def seeds(cell: Cell) -> range:
    """Seeds of the flights of a cell."""
    return range(FIRST_SEED, FIRST_SEED + SEEDS * (2 if cell.radio in LOSSY else 1))


def flights(cell: Cell, seeds: Sequence[int]) -> list[Scenario]:
    """The flights of a cell, each with the shortest period in which a round and the learning fit.

    The classifier trains for ten ticks of a period, after the global model has arrived. It flies for as many whole
    periods as `LEARNING_S` has room for.
    """
    settings = [*radios()[cell.radio], *WAYS[cell.way], *ACCESS[cell.access], *POWER, "federation.fraction=1.0"]
    found = []
    for seed in seeds:
        flown = scenario.load(None, settings, method=cell.method, seed=seed)
        ticks = round_ticks(flown)
        if cell.method == "classifier":
            period = ticks + TRAINING_TICKS
            whole = int(LEARNING_S / flown.dt) // period
            flown = msgspec.structs.replace(flown, stop="duration", duration=whole * period * flown.dt)
        else:
            period = max(ticks, PERIOD_TICKS)
        found.append(with_period(flown, period))
    return found


def round_ticks(flown: Scenario) -> int:
    """Ticks of a round: from its uploads to the global model in place, and the least period that is accepted."""
    try:
        plan = plan_of(with_period(flown, 1))
    except BadInput as error:
        plan = plan_of(with_period(flown, int(re.findall(r"at least (\d+)", str(error))[-1])))
    last = plan.hops[-1]
    return max(plan.period_ticks, last.after + (0 if last.is_local else last.attempt_ticks))


def with_period(flown: Scenario, ticks: int) -> Scenario:
    """The scenario with rounds every `ticks` ticks."""
    return msgspec.structs.replace(flown, federation=msgspec.structs.replace(flown.federation, period=ticks))


class LastDiagnostics:
    """Sink that keeps the diagnostics of the last tick, (N, K)."""

    def __init__(self) -> None:
        self.values = np.empty((0, 0))

    def write(self, row: Row) -> None:
        """Keep the diagnostics of a row."""
        self.values = row.diagnostics


def measure(flown: Scenario) -> dict[str, Any]:
    """Fly a scenario; the cost of a round, mean over the flight, and what the UAVs have learned.

    Accuracies are those of the last tick: mean and least of the UAVs.
    """
    load_classifier()
    engine, last = Engine(flown, f"{flown.method}-s{flown.seed}"), LastDiagnostics()
    engine.add_sink(last)
    summary = engine.complete()
    rounds = summary["rounds"] + summary["rounds_void"]
    classifies = flown.method == "classifier"
    radio = summary["radio"]
    return {
        "round_s": round_ticks(flown) * flown.dt,
        "rounds": rounds,
        "void": summary["rounds_void"],
        "kbit": summary["payload_bits"]["total"] / 1e3 / rounds,
        "airtime_s": radio["airtime_s"] / rounds,
        "band_time_MHz_s": radio["band_time_Hz_s"] / 1e6 / rounds,
        "radio_J": summary["energy_radio_J"] / rounds,
        "lost_share": radio["outage_rate"],
        "accuracy": float(last.values[:, 0].mean()) if classifies else None,
        "accuracy_least": float(last.values[:, 0].min()) if classifies else None,
        "tracking": None if classifies else summary["diagnostics"]["tracking_cost"] / summary["uavs"],
        "arrived": summary["arrived"],
        "uavs": summary["uavs"],
    }
