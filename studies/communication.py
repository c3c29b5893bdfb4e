"""Measures what narrow payloads cost and save, and writes the tables of communication.md."""

from typing import Any

import numpy as np
from msgspec import structs

from meanflock.channel.link import slots_needed
from meanflock.federation import coding as codings
from meanflock.federation.coding import Coding, Feedback
from meanflock.federation.rules.fedavg import mean
from meanflock.federation.schedule import Schedule
from meanflock.groundstation import statistics
from meanflock.groundstation.launch.engine import Engine
from meanflock.studies import published
from meanflock.studies.markdown import replaced, table
from meanflock.swarm import process, scenario
from meanflock.swarm.declared import controller
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import Act, FrameKind, Frames
from meanflock.swarm.wire.tick import write_act

PAGE = published.DOCS / "communication.md"
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
CLEAR = ("radio.bits_per_float=64", "radio.target_snr_db=60", "duration=160", 'stop="duration"')  # no outages


def main() -> None:
    """Flies every case and writes the tables."""
    given = published.options(__doc__, seeds=20).parse_args()
    points = {
        (method, name): [scenario.load(None, settings, method=method, seed=seed) for seed in range(1, given.seeds + 1)]
        for method in METHODS
        for name, settings in WRITTEN.items()
    }
    runs = published.flown("communication", points, given.jobs)
    tables = {
        "transmissions": transmissions(),
        "flights": flights(runs),
        "rounding": rounding(range(1, 6)),
    }
    page = PAGE.read_text(encoding="utf-8")
    for name, lines in tables.items():
        page = replaced(page, f"<!-- {name} -->", "<!-- end -->", ["", *lines, ""])
    PAGE.write_text(page, encoding="utf-8")
    print(PAGE)


def transmissions() -> list[str]:
    """Bits, slots and wire bytes of one upload."""
    rows = []
    for method in METHODS:
        for name in ("float64", "float32", "float16", "int8"):
            written = scenario.load(None, WRITTEN[name], method=method)
            coding = codings.of_uploads(written)
            coded = coding.encode(np.full((1, coding.floats), 1.5))
            sent = Frames(FrameKind.UPLOAD, 5, np.zeros(1, np.int32), coded)
            bare = Act(2**31, 1000, np.ones((1, 2 + len(written.declared.diagnostics))))
            wire = len(write_act(structs.replace(bare, outbox=(sent,)))) - len(write_act(bare))
            slots = slots_needed(written.radio, coding.bits)
            rows.append((f"`{method}`", name, f"{coding.bits:,}", f"{slots}", f"{wire / coded.nbytes:.3f}"))
    return table(("method", "payload", "bits", "slots K", "wire bytes / payload bytes"), rows)


def flights(runs: dict[Any, list[dict[str, Any]]]) -> list[str]:
    """What the codings did to whole flights."""
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


def rounding(seeds: range) -> list[str]:
    """What rounding takes from the mean of one round, and from the mean over all rounds of a flight."""
    rows = []
    for method in METHODS:
        clear = scenario.load(None, CLEAR, method=method)
        flights = [uploads(scenario.load(None, (*CLEAR, f"seed={seed}"), method=method)) for seed in seeds]
        for name in ("float16", "int8"):
            for active in (False, True):
                coding = Coding(name, clear.declared.parts)
                off = np.mean([distances(clear, coding, active, rounds) for rounds in flights], axis=0)
                rows.append((f"`{method}`", name, "yes" if active else "no", f"{off[0]:.1e}", f"{off[1]:.1e}"))
    return table(("method", "payload", "feedback", "one round", "all rounds"), rows)


def uploads(flown: Scenario) -> list[Frames]:
    """Every round's uploads of one flight: the participants' models as they are when it opens, in double precision."""
    rounds, sent = Schedule(flown), []
    shared = controller(flown).shared  # of the weights, what the method shares

    def look(engine: Engine) -> None:
        flight = engine.world.flight
        if not flight.over and (number := rounds.opens(flight.tick)):
            source = rounds.participants(number).astype(np.int32)
            sent.append(Frames(FrameKind.UPLOAD, number, source, engine.models[source, shared]))

    Engine(flown, "communication").complete(look)
    return sent


def distances(flown: Scenario, coding: Coding, active: bool, rounds: list[Frames]) -> tuple[float, float]:
    """‖mean received − mean meant‖ / ‖mean meant‖: of a round, and of all together."""
    feedback = Feedback(coding, flown.uavs, active=active)
    off, meant = [], []
    for batch in rounds:
        rows = batch.source.astype(np.intp)
        means = [mean(models) for models in (coding.decode(feedback.encode(rows, batch.payload)), batch.payload)]
        off.append(means[0] - means[1])
        meant.append(means[1])
    norm = np.linalg.norm
    return float(np.median(norm(off, axis=1) / norm(meant, axis=1))), float(
        norm(np.sum(off, 0)) / norm(np.sum(meant, 0))
    )


def _at(summary: dict[str, Any], path: tuple[str, ...]) -> float:
    for name in path:
        summary = summary[name]
    return float("nan") if summary is None else float(summary)  # type: ignore[arg-type]


if __name__ == "__main__":
    process.main(main)
