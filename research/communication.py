"""Measures the effects of narrow payloads and writes the tables of communication.md."""

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from meanflock.channel.link import slots_needed
from meanflock.federation.codec import Codec
from meanflock.federation.codings.base import FINEST
from meanflock.federation.codings.int8 import STEPS
from meanflock.federation.cut import coding_of
from meanflock.federation.memory import Feedback
from meanflock.federation.plan import plan_of
from meanflock.federation.rules.base import mean
from meanflock.federation.schedule import Schedule
from meanflock.launch.engine import Engine
from meanflock.net import process
from meanflock.net.tick import write_act
from meanflock.results import statistics
from meanflock.studies import published
from meanflock.studies.markdown import table, with_parts
from meanflock.studies.study import seeded
from meanflock.swarm import scenario
from meanflock.swarm.declared import controller
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.state import Floats
from meanflock.swarm.wire.messages import Act, FrameKind, Frames

PAGE = published.DOCS / "communication.md"
FIRST_SEED = 198101
METHODS = ("mfgfl-hf", "mfgfl-h", "mfgfl-f")
WRITTEN = {  # name of the row → settings
    "float64": ("radio.bits_per_float=64",),
    "float32": (),
    "float16": ("federation.payload=float16", "federation.broadcast_payload=float16"),
    "int8": ("federation.payload=int8", "federation.broadcast_payload=int8"),
    "int8, no feedback": (
        "federation.payload=int8",
        "federation.broadcast_payload=int8",
        "federation.error_feedback=false",
    ),
    "int8 up, float32 down": ("federation.payload=int8",),
}
ROUNDED = ("float16", "int8")
ROUNDING_SEEDS = range(198201, 198206)
CLEAR = ("radio.bits_per_float=64", "radio.target_snr_db=60", "duration=160", 'stop="duration"')  # no outages

Transmit = Callable[[NDArray[np.intp], Floats], Floats]  # UAVs (S,) and their models (S, L) → models as received


def main() -> None:
    """Flies every case and writes the tables."""
    given = published.options(__doc__, seeds=20).parse_args()
    points = {
        (method, name): seeded(scenario.load(None, settings, method=method, seed=FIRST_SEED), given.seeds)
        for method in METHODS
        for name, settings in WRITTEN.items()
    }
    clear = {
        method: [scenario.load(None, CLEAR, method=method, seed=seed) for seed in ROUNDING_SEEDS] for method in METHODS
    }
    measured = published.flown("rounding", clear, given.jobs, measure_rounding)
    tables = {
        "transmissions": transmissions(),
        "flights": [*flights(published.flown("communication", points, given.jobs)), "", published.flown_by()],
        "rounding": rounding(measured),
        "rejected": rejected(measured),
    }
    PAGE.write_text(with_parts(PAGE.read_text(encoding="utf-8"), tables), encoding="utf-8")
    print(PAGE)


def transmissions() -> list[str]:
    """Bits, slots and wire bytes of one upload."""
    rows = []
    for method in METHODS:
        for name in ("float64", "float32", "float16", "int8"):
            written = scenario.load(None, WRITTEN[name], method=method)
            declared, codec = plan_of(written).declared, plan_of(written).hops[0].codec
            uav = np.zeros(1, np.int32)
            rows_sent = codec.rows(codec.encode(np.full((1, codec.floats), 1.5), uav, 5), np.ones((1, 1)))
            sent = Frames(FrameKind.UPLOAD, 5, uav, rows_sent)
            bare = Act(2**31, 1000, np.ones((1, 2 + len(declared.diagnostics))))
            wire = len(write_act(structs.replace(bare, outbox=(sent,)))) - len(write_act(bare))
            slots = slots_needed(written.radio, codec.bits)
            rows.append((f"`{method}`", name, f"{codec.bits:,}", f"{slots}", f"{wire / rows_sent.nbytes:.3f}"))
    return table(("method", "payload", "bits", "slots K", "wire bytes / payload bytes"), rows)


def flights(runs: dict[Any, list[dict[str, Any]]]) -> list[str]:
    """Traffic, travel time and energy of whole flights with each coding."""
    head = ("method", "payload", "up, kbit", "down, kbit", "arrived", "travel time, s", "energy until own arrival, J")
    rows = []
    for (method, name), summaries in runs.items():

        def mean(*path: str, factor: float = 1.0, spread: bool = False, runs: Any = summaries) -> str:
            found = statistics.mean([factor * _at(summary, path) for summary in runs])
            return f"{found.value:.4g} ± {found.high - found.value:.2g}" if spread else f"{found.value:,.4g}"

        row = (
            f"`{method}`",
            name,
            mean("payload_bits", "uplink", factor=1e-3),
            mean("payload_bits", "broadcast", factor=1e-3),
            f"{sum(one['arrived'] for one in summaries):,} of {sum(one['uavs'] for one in summaries):,}",
            mean("t_avg_censored_s", spread=True),
            mean("energy_mean_J", spread=True),
            mean("phi_A", spread=True),
            f"{mean('radio', 'outage_rate', factor=100)} ({mean('radio', 'outage_rate_theory', factor=100)})",
            mean("radio", "latency_slots_mean"),
        )
        rows.append(row)
    return table((*head, "alignment φ_A, m/s", "outages, %", "latency, slots"), rows)


def rounding(runs: Mapping[str, Sequence[Mapping[str, Any]]]) -> list[str]:
    """Error by rounding of the mean of one round, and of the mean over all rounds of a flight."""
    rows = []
    for method, measured in runs.items():
        for name, active in product(ROUNDED, (False, True)):
            off = np.mean([row[_case(name, active)] for row in measured], axis=0)
            rows.append((f"`{method}`", name, "yes" if active else "no", f"{off[0]:.1e}", f"{off[1]:.1e}"))
    return table(("method", "payload", "feedback", "one round", "all rounds"), rows)


def measure_rounding(flown: Scenario) -> dict[str, tuple[float, float]]:
    """The distances of one flight, by coding and feedback; see `distances`."""
    rounds = uploads(flown)
    found = {
        _case(name, active): distances(rounds, Rounded(flown, name, active))
        for name, active in product(ROUNDED, (False, True))
    }
    return found | {name: distances(rounds, way(flown)) for name, way in REJECTED.items()}


def _case(name: str, active: bool) -> str:
    return f"{name}, feedback" if active else name


def uploads(flown: Scenario) -> list[Frames]:
    """The uploads of every round of one flight: the participants' models when the round opens, in double precision."""
    schedule = Schedule(plan_of(flown))
    shared = controller(flown).shared  # the weights that the method shares
    sent: list[Frames] = []

    def look(engine: Engine) -> None:
        flight = engine.world.flight
        if not flight.over and (number := schedule.opens(flight.tick)):
            source = schedule.participants(number).astype(np.int32)
            sent.append(Frames(FrameKind.UPLOAD, number, source, engine.models[source, shared]))

    Engine(flown, "communication").complete(look)
    return sent


class Rounded:
    """Uploads in one of our codings, as the leader receives them."""

    def __init__(self, flown: Scenario, name: str, active: bool) -> None:
        self._codec = Codec(coding_of(flown, name), plan_of(flown).declared.parts)
        self._feedback = Feedback(self._codec, np.arange(flown.uavs), active=active)

    def __call__(self, rows: NDArray[np.intp], models: Floats) -> Floats:
        """The models (S, L) of some UAVs (S,), as they are received."""
        return self._codec.decode(self._feedback.encode(rows, models, 0))


class Stochastic:
    """Steps of `int8`, without feedback, each rounded up or down at random so that its expectation is the weight."""

    def __init__(self, flown: Scenario) -> None:
        self._sizes = plan_of(flown).declared.parts
        self._draw = np.random.default_rng(flown.seed)

    def __call__(self, rows: NDArray[np.intp], models: Floats) -> Floats:
        """See `Coded`."""
        largest = np.maximum.reduceat(np.abs(models), np.cumsum((0, *self._sizes[:-1])), axis=-1)
        step = np.repeat(np.maximum(largest, FINEST) / STEPS, self._sizes, axis=-1)
        return step * np.floor(models / step + self._draw.random(models.shape))


class LargestQuarter:
    """The largest quarter of the weights, each in half precision with its place, and feedback."""

    def __init__(self, flown: Scenario) -> None:
        self._residuals = np.zeros((flown.uavs, plan_of(flown).declared.parameters))

    def __call__(self, rows: NDArray[np.intp], models: Floats) -> Floats:
        """See `Coded`."""
        meant = models + self._residuals[rows]
        bound = np.quantile(np.abs(meant), 0.75, axis=-1, keepdims=True)
        received = np.where(np.abs(meant) >= bound, meant, 0.0).astype(np.float16).astype(np.float64)
        self._residuals[rows] = meant - received
        return received


class Differences:
    """Differences to the last global model, in a coding; every UAV has to know that model."""

    def __init__(self, flown: Scenario, coded: Transmit) -> None:
        self._coded = coded
        self._last: Floats = np.zeros(plan_of(flown).declared.parameters)

    def __call__(self, rows: NDArray[np.intp], models: Floats) -> Floats:
        """See `Coded`."""
        received = self._last + self._coded(rows, models - self._last)
        self._last = mean(received)
        return received


LARGEST = "largest quarter of differences"
REJECTED: dict[str, Callable[[Scenario], Transmit]] = {
    "`int8`, rounded at random": Stochastic,
    "`int8` of differences": lambda flown: Differences(flown, Rounded(flown, "int8", True)),
    LARGEST: lambda flown: Differences(flown, LargestQuarter(flown)),
}


def rejected(runs: Mapping[str, Sequence[Mapping[str, Any]]]) -> list[str]:
    """Errors of the codings that meanflock does not have, and the bits of an upload."""
    rows = []
    for method, measured in runs.items():
        declared = plan_of(scenario.load(None, (), method=method)).declared
        bits = dict.fromkeys(REJECTED, Codec(coding_of(scenario.load(None, ()), "int8"), declared.parts).bits)
        bits[LARGEST] = declared.parameters // 4 * (16 + math.ceil(math.log2(declared.parameters)))
        for name in REJECTED:
            off = np.mean([row[name] for row in measured], axis=0)
            rows.append((f"`{method}`", name, f"{bits[name]:,}", f"{off[0]:.1e}", f"{off[1]:.1e}"))
    return table(("method", "coding", "bits", "one round", "all rounds"), rows)


def distances(rounds: Sequence[Frames], coded: Callable[[NDArray[np.intp], Floats], Floats]) -> tuple[float, float]:
    """‖received mean − exact mean‖ / ‖exact mean‖: the median over rounds, and of the sums over all rounds."""
    differences = []
    exact = []
    for batch in rounds:
        exact.append(mean(batch.payload))
        differences.append(mean(coded(batch.source.astype(np.intp), batch.payload)) - exact[-1])
    norm = np.linalg.norm
    of_one = float(np.median(norm(differences, axis=1) / norm(exact, axis=1)))
    of_all = float(norm(np.sum(differences, axis=0)) / norm(np.sum(exact, axis=0)))
    return of_one, of_all


def _at(summary: dict[str, Any], path: tuple[str, ...]) -> float:
    for name in path:
        summary = summary[name]
    return float("nan") if summary is None else float(summary)  # type: ignore[arg-type]


if __name__ == "__main__":
    from research import communication  # worker processes find `measure_rounding` in it under this name

    process.main(communication.main)
