"""Numbers of the structural readings: what the length of a round does, what other readings change, what cannot help.

`meanflock paper` flies what they need; with `--only exchanged --only fig3 --only fig6` nothing else.
"""

from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from meanflock.channel.link import outage, slot_success, slots_needed
from meanflock.federation.plan import plan_of
from meanflock.kernels.mean_field.layout import MODEL_FLOATS, VALUE
from meanflock.launch.engine import Engine
from meanflock.launch.station import StoredTelemetry
from meanflock.results import statistics
from meanflock.results.statistics import Estimate
from meanflock.swarm import state
from meanflock.swarm.scenario import Scenario, load
from meanflock.swarm.scenario.tables import Radio
from meanflock.swarm.wire.messages import Status
from research.reproduction import regimes, report
from research.reproduction.grid import (
    COMMON,
    COMPARED,
    DRIFTING,
    EQUAL_ROUNDS,
    EXCHANGED,
    FEWER_UPLOADS,
    HELD_BACK,
    LOSSLESS,
    PAPER_EXCHANGED,
    PERIODS,
    WITHOUT_DENSITY,
    Method,
)
from research.reproduction.measure import SEEDS
from research.reproduction.tables import Frame, Results, View
from research.reproduction.tables import load as load_tables
from research.reproduction.verdict import HOLDING, evaluate, of_setting

Record = dict[str, Any]
Floats = NDArray[np.float64]

DEFAULT, AT_DEFAULT, IN_EXCHANGED = "default", "learner.exchanged_rounds", "paper-exchanged"
READINGS = (  # name, experiment and setting
    (DEFAULT, "s0", ""),
    (AT_DEFAULT, "exchanged", EXCHANGED),
    (IN_EXCHANGED, "exchanged", ", ".join(PAPER_EXCHANGED)),
    *((f"wind.common = {share:g}", "common", f"wind.common={share}") for share in COMMON),
    *(
        (f"{IN_EXCHANGED}, wind.common = {share:g}", "common", ", ".join((*PAPER_EXCHANGED, f"wind.common={share}")))
        for share in COMMON
    ),
    ("learner.act_after_s = 10", "held-back", HELD_BACK),
    (f"{IN_EXCHANGED}, learner.act_after_s = 10", "held-back", ", ".join((*PAPER_EXCHANGED, HELD_BACK))),
    ("cost.c2 = 0", "density", WITHOUT_DENSITY),
)
OF_A_ROUND = ("t_avg_censored_s", "energy_mean_J", "phi_A_tavg", "phi_C_tavg", "speed_max_m_s")
RATIOS = (  # metric, numerator and denominator
    ("t_avg_censored_s", "mfgfl-hf", "mfgfl-h"),
    ("energy_mean_J", "mfgfl-hf", "mfgfl-h"),
    ("phi_A_175", "mfgfl-hf", "mfgfl-h"),
    ("phi_C_175", "mfgfl-hf", "hjb"),
    ("phi_C_distinct_175", "mfgfl-hf", "hjb"),
)
DRIFT_S = 30.0
SCENARIOS = ("paper", "paper-slow", "paper-printed", "paper-exchanged")

# -- flights of the grid -----------------------------------------------------------------------------------------------


def rounds(view: View) -> list[Record]:
    """Means by method and length of a round."""
    rows = []
    for method, period in product(("mfgfl-h", "mfgfl-hf", "mfgfl-f"), PERIODS):
        frame = view.cell("period", method, period)
        rows.append(
            {"method": method, "period": period, "seeds": len(frame)}
            | {metric: _numbers(statistics.mean(frame[metric])) for metric in OF_A_ROUND}
        )
    return rows


def readings(results: Results, view: View) -> list[Record]:
    """What each reading changes: time and energy with both models shared, ratios of means, and the claims about S0 that
    hold."""
    rows = []
    for name, experiment, setting in READINGS:
        frames = {m: view.cell(experiment, m, setting=setting) for m in COMPARED}
        both = frames[Method.MFGFL_HF]
        row: Record = {"name": name, "seeds": len(both)}
        row |= {metric: _numbers(statistics.mean(both[metric])) for metric in ("t_avg_censored_s", "energy_mean_J")}
        for metric, first, second in RATIOS:
            row[f"{metric}, {first} / {second}"] = _ratio(frames[Method(first)], frames[Method(second)], metric)
        records = evaluate(of_setting(results, (experiment,), setting))
        about = [r for r in records if r["scenario"].startswith("S0") and r["tests"] and r["id"].startswith(("C", "O"))]
        row["holds"] = [record["id"] for record in about if record["verdict"] in HOLDING]
        rows.append(row)
    return rows


def without_density(view: View) -> Record:
    """Means of `mfgfl-hf` with c2 = 0 over those with the printed c2."""
    without, printed = view.cell("density", "mfgfl-hf", setting=WITHOUT_DENSITY), view.cell("s0", "mfgfl-hf")
    metrics = ("t_avg_censored_s", "energy_mean_J", "phi_A_175")
    return {"seeds": len(without)} | {metric: _ratio(without, printed, metric) for metric in metrics}


def collisions(view: View) -> list[Record]:
    """By reading and method: colliding pairs of a flight and flights without, between ticks too and at ticks."""
    rows = []
    for (name, experiment, setting), method in product(READINGS, COMPARED):
        frame = view.cell(experiment, method, setting=setting)
        row: Record = {"name": name, "method": str(method), "seeds": len(frame)}
        for metric in ("collisions", "collisions_at_ticks"):
            row[metric] = _numbers(statistics.mean(frame[metric]))
            row[f"{metric}_free"] = int(np.count_nonzero(frame[metric] == 0))
        rows.append(row)
    return rows


def drift(view: View) -> list[Record]:
    """Collisions in the first 30 s of a swarm that only drifts, by the common share of the noise."""
    rows = []
    for share in (0.0, *COMMON):
        seen = view.series.where(experiment="drift", setting=f"{DRIFTING}, wind.common={share}", t_s=DRIFT_S)
        rows.append({"common": share, "seeds": len(seen), "collisions": _numbers(statistics.mean(seen["collisions"]))})
    return rows


def losses(view: View) -> Record:
    """φ_A(T_avg) at rounds of 200 ticks: sharing both models over the value model with and without losses, and what
    lost uploads and lost downloads do."""
    metric = "phi_A_tavg"
    lossy = {method: view.cell("period", f"mfgfl-{method}", 200) for method in ("h", "hf")}
    clear = {
        method: view.cell("losses", f"mfgfl-{method}", setting=f"{EQUAL_ROUNDS}, {LOSSLESS}") for method in ("h", "hf")
    }
    fewer = view.cell("losses", "mfgfl-hf", setting=f"{EQUAL_ROUNDS}, {LOSSLESS}, {FEWER_UPLOADS}")
    return {
        "seeds": len(fewer),
        "with losses, HF / H": _ratio(lossy["hf"], lossy["h"], metric),
        "without losses, HF / H": _ratio(clear["hf"], clear["h"], metric),
        "HF, an eighth fewer uploads / all": _ratio(fewer, clear["hf"], metric),
        "HF, with losses / an eighth fewer uploads": _ratio(lossy["hf"], fewer, metric),
        "HF, with losses / without": _ratio(lossy["hf"], clear["hf"], metric),
        "broadcast_outage_rate": {
            method: _numbers(statistics.mean(frame["broadcast_outage_rate"])) for method, frame in lossy.items()
        },
    }


def searched(view: View, described: Record) -> Record:
    """Scores of the settings of the map whose rounds are as printed, with those rounds and with exchanged ones."""
    exchanged = regimes.places(view, "exchanged-map")
    usual = {place["setting"]: place for place in described["settings"]}
    best = regimes.best(exchanged, 3)
    return {
        "settings": len(exchanged),
        "claims": len(described["claims"]),
        "exchanged": [round(place.score, 3) for place in regimes.best(exchanged)],
        "printed": sorted(
            (usual[_printed(place.setting)]["score"] for place in exchanged if _few(usual[_printed(place.setting)])),
            reverse=True,
        )[:10],
        "best": [{"setting": place.setting, "score": round(place.score, 3)} for place in best],
    }


def _printed(setting: str) -> str:
    return setting.removesuffix(EXCHANGED).removesuffix(", ")


def _few(place: Record) -> bool:
    return bool(place["never_arrived"] < regimes.FEW_ARRIVE)


def _ratio(first: Frame, second: Frame, metric: str) -> list[float | None]:
    a, b = first.by_seed(metric), second.by_seed(metric)
    seeds = sorted(a.keys() & b.keys())
    return _numbers(statistics.ratio([a[seed] for seed in seeds], [b[seed] for seed in seeds]))


def _numbers(found: Estimate) -> list[float | None]:
    return [float(f"{number:.6g}") if np.isfinite(number) else None for number in (found.value, found.low, found.high)]


# -- the density in the cost -------------------------------------------------------------------------------------------


def cost_shares(seeds: Sequence[int] = SEEDS) -> Record:
    """By scenario: share of c₂φ_G, as the UAVs of `mfgfl-hf` believe it, in the cost of a flight; see `cost_share`."""
    scenarios = {name: [load(Path(name), seed=seed) for seed in seeds] for name in SCENARIOS}
    shares = {name: _numbers(statistics.mean(list(map(cost_share, flown)))) for name, flown in scenarios.items()}
    return {"seeds": len(seeds)} | shares


def cost_share(scenario: Scenario) -> float:
    """Share of c₂φ_G in the sizes of all terms of the running cost, |v·r|/‖r‖ + c1‖v‖² + c3‖a‖² + c2φ_G, summed over
    all ticks of UAVs on the way."""
    telemetry = StoredTelemetry()
    Engine(scenario, "cost", sinks=[telemetry]).complete()
    blocks = [np.concatenate([getattr(block, name) for block in telemetry.blocks]) for name in ("states", "status")]
    commands, diagnostics = (
        np.concatenate([getattr(block, name) for block in telemetry.blocks])[1:].astype(np.float64)
        for name in ("accelerations", "diagnostics")
    )
    states, on_way = blocks[0][:-1], blocks[1][:-1] == Status.FLYING
    phi_g = diagnostics[..., plan_of(scenario).declared.diagnostics.index("phi_G")]
    position, velocity = state.position(states), state.velocity(states)
    towards = np.abs(state.dot(position, velocity)) / np.sqrt(state.dot(position, position))
    cost = scenario.cost
    others = towards + cost.c1 * state.dot(velocity, velocity) + cost.c3 * state.dot(commands, commands)
    density = cost.c2 * phi_g
    return float(density[on_way].sum() / (density + others)[on_way].sum())


# -- the channel -------------------------------------------------------------------------------------------------------

_TRIP_TICKS = 1750
_UPLOADS = 0.8 * 24  # of UAVs that have to send theirs by radio
_TARGETS_DB = np.arange(60.0, 85.25, 0.25)
_SLOTS_S = (1e-5, 2.5e-5, 5e-5, 1e-4, 1e-3)
_THRESHOLDS = (1, 2, 4, 8, 16, 32)


def channels() -> Record:
    """The most global models that a UAV takes over under `mfgfl-hf`, over those under `mfgfl-h`, in a trip of 175 s:
    among all target SNRs, slots and latency thresholds in which `mfgfl-h` gets two or more.

    `one`: the latency threshold is one for both. `doubled`: that of `mfgfl-hf` is twice as long, like its rounds.
    """
    result: Record = {"settings": len(_TARGETS_DB) * len(_SLOTS_S) * len(_THRESHOLDS)}
    for name, longer in (("one", 1), ("doubled", 2)):
        ratios = []
        for target, slot, threshold in product(_TARGETS_DB.tolist(), _SLOTS_S, _THRESHOLDS):
            changed = {"target_snr_db": target, "coherence_time_s": slot, "latency_threshold_slots": threshold}
            radio = msgspec.structs.replace(Scenario().radio, **changed)
            single = taken_over(radio, VALUE.stop - VALUE.start, 100)
            if single >= 2.0:
                radio = msgspec.structs.replace(radio, latency_threshold_slots=longer * threshold)
                ratios.append(taken_over(radio, MODEL_FLOATS, 200) / single)
        result[name] = float(f"{max(ratios):.6g}")
    return result


def taken_over(radio: Radio, floats: int, period: int) -> float:
    """Expected number of global models of so many floats that a UAV receives in a trip of 175 s.

    A round is void if no upload arrives. α is 0, so every distance is like any other.
    """
    bits = floats * radio.bits_per_float
    if slots_needed(radio, bits) > radio.latency_threshold_slots:
        return 0.0
    delivered = 1.0 - float(outage(radio, slot_success(radio, np.array([1.0])), bits)[0])
    return (_TRIP_TICKS // period) * (1.0 - (1.0 - delivered) ** _UPLOADS) * delivered


# -- all ---------------------------------------------------------------------------------------------------------------


def numbers(out: Path, described: Record) -> Record:
    """All numbers, from the tables of the grid in `out` and from `described`, the map as published."""
    results = load_tables(out)
    view = View.from_results(results)
    return {
        "code": report.versions(view),
        "rounds": rounds(view),
        "readings": readings(results, view),
        "density": without_density(view),
        "collisions": collisions(view),
        "drift": drift(view),
        "losses": losses(view),
        "map": searched(view, described),
        "cost": cost_shares(),
        "channels": channels(),
    }
