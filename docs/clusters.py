"""Measures what clusters cost beside one leader for all, and writes the table of scaling.md."""

import argparse
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed

from meanflock.federation.schedule import Schedule
from meanflock.federation.topology.clusters import Division
from meanflock.groundstation.launch.engine import Engine
from meanflock.groundstation.launch.station import Kept
from meanflock.studies.markdown import replaced
from meanflock.swarm import scenario
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import FrameKind

PAGE = Path(__file__).with_name("scaling.md")
UAVS = (100, 400)
RADIOS = {  # name of the row → settings
    "the paper's, α = 0": (),
    "α = 2, 400 times the power": ("radio.path_loss_exponent=2.0", "radio.tx_power_dbm=46"),
}
FLIGHT = ("duration=101", 'stop="duration"')  # five rounds of mfgfl-hf


def main() -> None:
    given = argparse.ArgumentParser(description=__doc__)
    given.add_argument("--seeds", type=int, default=10)
    given.add_argument("--jobs", type=int, default=-1)
    asked = given.parse_args()
    flown = {
        (radio, uavs, count): [
            scenario.load(None, [*settings, *FLIGHT, f"federation.clusters={count}"], uavs=uavs, seed=seed)
            for seed in range(1, asked.seeds + 1)
        ]
        for radio, settings in RADIOS.items()
        for uavs in UAVS
        for count in (1, 5, round(uavs**0.5))
    }
    jobs = Parallel(n_jobs=asked.jobs, verbose=5)
    measured = iter(jobs(delayed(measure)(of) for seeds in flown.values() for of in seeds))
    lines = [
        "| radio | N | K | received by UAV h | up, kbit | airtime, ms | busiest receiver, ms | lost, % "
        "| in the mean, % | ticks |",
        f"|{'---|' * 10}",
    ]
    for (radio, uavs, count), seeds in flown.items():
        rows = [next(measured) for _ in seeds]
        mean = {name: np.mean([row[name] for row in rows]) for name in rows[0]}
        cells = (
            f"{mean['heard']:.1f}", f"{mean['kbit']:,.0f}", f"{mean['airtime']:.2f}", f"{mean['queue']:.2f}",
            f"{mean['lost']:.1f}", f"{mean['share']:.1f}", f"{mean['ticks']:.0f}",
        )  # fmt: skip
        lines.append(f"| {radio} | {uavs} | {count} | {' | '.join(cells)} |")
    page = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(replaced(page, "<!-- clusters -->", "<!-- end -->", ["", *lines, ""]), encoding="utf-8")
    print(PAGE)


def measure(of: Scenario) -> dict[str, float]:
    """What a round of one flight came to, on the way up; means over its rounds."""
    summary = Engine(of, "clusters", sinks=[kept := Kept()]).complete()
    up = [summary["radio"]["traffic"][name] for name in ("uplink", "relay")]
    rounds, leader = summary["rounds"], of.federation.leader
    links = np.concatenate([block.links for block in kept.blocks])
    sent = links[np.isin(links[:, 3], (FrameKind.UPLOAD, FrameKind.RELAY))]
    slot_ms = of.radio.coherence_time_s * 1e3
    return {
        "heard": np.count_nonzero(sent[:, 2] == leader) / rounds,
        "kbit": sum(bill["payload_bits"] for bill in up) / 1e3 / rounds,
        "airtime": sum(bill["airtime_s"] for bill in up) * 1e3 / rounds,
        "queue": np.bincount(sent[:, 2], np.abs(sent[:, 4])).max() * slot_ms / rounds,
        "lost": 100 * sum(bill["outages"] for bill in up) / sum(bill["sent"] for bill in up),
        "share": float(np.mean([_share(of, sent, number) for number in range(1, rounds + 1)])),
        "ticks": next(tick for tick in range(of.period_ticks, 10**6) if Schedule(of).closes(tick))
        - of.period_ticks
        + 1,
    }


def _share(of: Scenario, sent: np.ndarray, number: int) -> float:
    """Percent of the models of a round that are in its mean."""
    of_round = sent[(sent[:, 0] >= number * of.period_ticks) & (sent[:, 0] < (number + 1) * of.period_ticks)]
    failed = of_round[of_round[:, 4] < 0]
    uploads, relays = (failed[failed[:, 3] == kind, 1] for kind in (FrameKind.UPLOAD, FrameKind.RELAY))
    source = Schedule(of).participants(number)
    lost = np.isin(source, uploads) | np.isin(Division(of).head_of[source], relays)
    return float(100 * (1 - lost.mean()))


if __name__ == "__main__":
    main()
