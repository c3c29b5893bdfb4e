"""Measures the cost of clusters relative to one leader, and writes the table of scaling.md."""

import numpy as np

from meanflock.federation.plan import plan_of
from meanflock.federation.schedule import Schedule
from meanflock.federation.topology.clusters import Division
from meanflock.launch.engine import Engine
from meanflock.launch.station import StoredTelemetry
from meanflock.net import process
from meanflock.studies import published
from meanflock.studies.markdown import replaced
from meanflock.studies.study import seeded
from meanflock.swarm import scenario
from meanflock.swarm.scenario import Scenario
from meanflock.swarm.wire.messages import FrameKind, LinkColumn

PAGE = published.DOCS / "scaling.md"
FIRST_SEED = 198301
UAVS = (100, 400)
RADIOS = {  # name of the row → settings
    "the paper's, α = 0": (),
    "α = 2, 400 times the power": ("radio.path_loss_exponent=2.0", "radio.tx_power_dbm=46"),
}
FLIGHT = ("duration=101", 'stop="duration"')  # five rounds of mfgfl-hf


def main() -> None:
    """Flies every case and writes the table."""
    given = published.options(__doc__, seeds=10).parse_args()
    points = {
        (radio, uavs, count): seeded(
            scenario.load(None, [*settings, *FLIGHT, f"federation.clusters={count}"], uavs=uavs, seed=FIRST_SEED),
            given.seeds,
        )
        for radio, settings in RADIOS.items()
        for uavs in UAVS
        for count in (1, 5, round(uavs**0.5))
    }
    lines = [
        "| radio | N | K | received by UAV h | up, kbit | airtime, ms | busiest receiver, ms | lost, % "
        "| in the mean, % | ticks |",
        f"|{'---|' * 10}",
    ]
    for (radio, uavs, count), rows in published.flown("clusters", points, given.jobs, measure).items():
        mean = {name: np.mean([row[name] for row in rows]) for name in rows[0]}
        cells = (
            f"{mean['received']:.1f}", f"{mean['kbit']:,.0f}", f"{mean['airtime']:.2f}", f"{mean['queue']:.2f}",
            f"{mean['lost']:.1f}", f"{mean['share']:.1f}", f"{mean['ticks']:.0f}",
        )  # fmt: skip
        lines.append(f"| {radio} | {uavs} | {count} | {' | '.join(cells)} |")
    page = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(
        replaced(page, "<!-- clusters -->", "<!-- end -->", ["", *lines, "", published.flown_by(), ""]),
        encoding="utf-8",
    )
    print(PAGE)


def measure(flown: Scenario) -> dict[str, float]:
    """Cost of the uplink of a round; means over the rounds of one flight."""
    summary = Engine(flown, "clusters", sinks=[record := StoredTelemetry()]).complete()
    up = [summary["radio"]["traffic"][name] for name in ("uplink", "relay")]
    rounds, leader = summary["rounds"], flown.federation.leader
    links = np.concatenate([block.links for block in record.blocks])
    sent = links[np.isin(links[:, LinkColumn.KIND], (FrameKind.UPLOAD, FrameKind.RELAY))]
    slot_ms = flown.radio.coherence_time_s * 1e3
    row = {
        "received": np.count_nonzero(sent[:, LinkColumn.TARGET] == leader) / rounds,
        "kbit": sum(bill["payload_bits"] for bill in up) / 1e3 / rounds,
        "airtime": sum(bill["airtime_s"] for bill in up) * 1e3 / rounds,
        "queue": np.bincount(sent[:, LinkColumn.TARGET], sent[:, LinkColumn.SLOTS]).max() * slot_ms / rounds,
        "lost": 100 * sum(bill["outages"] for bill in up) / sum(bill["sent"] for bill in up),
        "share": float(np.mean([_share(flown, sent, number) for number in range(1, rounds + 1)])),
        "ticks": next(tick for tick in range(flown.period_ticks, 10**6) if Schedule(plan_of(flown)).closes(tick))
        - flown.period_ticks
        + 1,
    }
    return {name: float(value) for name, value in row.items()}


def _share(flown: Scenario, sent: np.ndarray, number: int) -> float:
    """Percent of the models of a round that reach the mean."""
    period = flown.period_ticks
    tick = sent[:, LinkColumn.TICK]
    failed = sent[(tick >= number * period) & (tick < (number + 1) * period) & (sent[:, LinkColumn.DELIVERED] == 0)]
    uploads, relays = (
        failed[failed[:, LinkColumn.KIND] == kind, LinkColumn.SOURCE] for kind in (FrameKind.UPLOAD, FrameKind.RELAY)
    )
    source = Schedule(plan_of(flown)).participants(number)
    lost = np.isin(source, uploads) | np.isin(Division(flown).head_of[source], relays)
    return float(100 * (1 - lost.mean()))


if __name__ == "__main__":
    from research import clusters  # worker processes find `measure` in it under this name

    process.main(clusters.main)
